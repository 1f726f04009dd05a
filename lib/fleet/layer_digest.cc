#include "lib/fleet/layer_digest.h"

#include <xxhash.h>

#include <algorithm>

#include "lib/base/status.h"
#include "lib/fleet/fleet.pb.h"
#include "lib/layers/validity.h"

namespace splinemap {
namespace {

void Fill(const MapOptions& options, fleet::MapRecord& record) {
  record.set_knot_interval_m(options.knot_interval_m);
  record.set_min_control_point(options.limits.min);
  record.set_max_control_point(options.limits.max);
}

absl::StatusOr<MapOptions> OptionsOf(const fleet::MapRecord& record) {
  const MapOptions options{record.knot_interval_m(),
                           {static_cast<ControlPoint>(record.min_control_point()),
                            static_cast<ControlPoint>(record.max_control_point())}};
  if (options.limits.min != record.min_control_point() ||
      options.limits.max != record.max_control_point()) {
    return InvalidArgument("its limits are no control points");
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOptions(options));
  return options;
}

}  // namespace

std::string EncodeDigest(const LayerDigest& digest) {
  fleet::DigestRecord record;
  record.mutable_layer()->set_name(digest.id.name);
  record.mutable_layer()->set_origin(digest.id.origin);
  record.set_session_number(digest.session.number);
  record.set_session_nonce(digest.session.nonce);
  record.set_revision(digest.revision);
  record.set_tiles(digest.tiles);
  record.set_hash(digest.hash);
  record.set_utime(digest.utime);
  Fill(digest.options, *record.mutable_map());
  record.set_tx0(digest.box.tx0);
  record.set_ty0(digest.box.ty0);
  record.set_tx1(digest.box.tx1);
  record.set_ty1(digest.box.ty1);
  record.set_is_arriving(digest.is_arriving);
  return record.SerializeAsString();
}

absl::StatusOr<LayerDigest> DecodeDigest(const std::string& value, const LayerId& id) {
  fleet::DigestRecord record;
  if (!record.ParseFromString(value)) return DataLoss("it is no digest");
  if (record.layer().name() != id.name || record.layer().origin() != id.origin) {
    return DataLoss("it is the digest of another layer");
  }
  LayerDigest digest{id,
                     {record.session_number(), record.session_nonce()},
                     record.revision(),
                     record.tiles(),
                     record.hash(),
                     record.utime(),
                     {},
                     {record.tx0(), record.ty0(), record.tx1(), record.ty1()},
                     record.is_arriving()};
  SPLINEMAP_RETURN_IF_ERROR(CheckSessionId(digest.session));
  SPLINEMAP_RETURN_IF_ERROR(CheckRevision(digest.revision));
  SPLINEMAP_ASSIGN_OR_RETURN(digest.options, OptionsOf(record.map()));
  return digest;
}

uint64_t HashOf(const LayerDigest& digest) {
  LayerDigest timeless = digest;
  timeless.utime = 0;
  const std::string value = EncodeDigest(timeless);
  return std::max<uint64_t>(XXH3_64bits(value.data(), value.size()), 1);
}

std::string EncodeMapOptions(const MapOptions& options) {
  fleet::MapRecord record;
  Fill(options, record);
  return record.SerializeAsString();
}

absl::StatusOr<MapOptions> DecodeMapOptions(const std::string& value) {
  fleet::MapRecord record;
  if (!record.ParseFromString(value)) return DataLoss("it is no record of a map");
  return OptionsOf(record);
}

std::string TextOf(const MapOptions& options) {
  return fmt::format("a knot interval of {:g} m and limits of {:g} to {:g} log-odds",
                     options.knot_interval_m,
                     static_cast<double>(options.limits.min) / kUnitsPerLogOdds,
                     static_cast<double>(options.limits.max) / kUnitsPerLogOdds);
}

}  // namespace splinemap
