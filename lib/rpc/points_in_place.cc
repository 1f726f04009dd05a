#include "lib/rpc/points_in_place.h"

#include <bit>
#include <cstring>

#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "lib/wire/message_type.h"

namespace splinemap {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr size_t kCountBytes = 4;
constexpr size_t kPointBytes = 2 * sizeof(double);
constexpr size_t kSampleBytes = 3 * sizeof(double) + 1;
constexpr size_t kHessianBytes = 3 * sizeof(double);

// The bytes have to be there: CheckTypeAndSize() is for what others sent.
void PutCount(size_t count, uint8_t* at) {
  const uint32_t bits = __builtin_bswap32(static_cast<uint32_t>(count));
  std::memcpy(at, &bits, sizeof(bits));
}

size_t CountAt(const uint8_t* at) {
  uint32_t bits = 0;
  std::memcpy(&bits, at, sizeof(bits));
  return __builtin_bswap32(bits);
}

// Item k of an array.
void Put(double value, uint8_t* array, size_t k) {
  const uint64_t bits = __builtin_bswap64(std::bit_cast<uint64_t>(value));
  std::memcpy(array + sizeof(bits) * k, &bits, sizeof(bits));
}

double DoubleAt(const uint8_t* array, size_t k) {
  uint64_t bits = 0;
  std::memcpy(&bits, array + sizeof(bits) * k, sizeof(bits));
  return std::bit_cast<double>(__builtin_bswap64(bits));
}

// The arrays of `count` doubles each that begin at a byte of a message, and what follows them.
template <typename Byte>
struct Arrays {
  Arrays(Byte* begin, size_t count)
      : first(begin),
        second(first + count * sizeof(double)),
        third(second + count * sizeof(double)),
        end(third + count * sizeof(double)) {}

  Byte* first;
  Byte* second;
  Byte* third;
  Byte* end;
};

}  // namespace

std::vector<uint8_t> EncodeRequest(const PointsQuery& query, Chunk chunk, const request_t& header) {
  points_request_t empty{};
  empty.header = header;
  empty.with_hessians = query.with_hessians ? 1 : 0;
  const auto empty_bytes = static_cast<size_t>(empty.getEncodedSize());
  std::vector<uint8_t> bytes(empty_bytes + chunk.size() * kPointBytes);
  empty.encode(bytes.data(), 0, static_cast<int>(empty_bytes));

  uint8_t* const x_m = bytes.data() + empty_bytes;
  uint8_t* const y_m = x_m + chunk.size() * sizeof(double);
  PutCount(chunk.size(), x_m - kCountBytes);
  const Eigen::Vector2d* const point_m = query.points_m.data() + chunk.begin;
  for (size_t k = 0; k < chunk.size(); ++k) {
    Put(point_m[k].x(), x_m, k);
    Put(point_m[k].y(), y_m, k);
  }
  return bytes;
}

std::optional<absl::StatusOr<PointsQuery>> DecodePointsRequest(absl::Span<const uint8_t> message) {
  if (!CheckTypeAndSize(MessageType::kPointsRequest, message).ok()) return std::nullopt;
  const uint8_t* at = message.data() + kFingerprintBytes + request_t()._getEncodedSizeNoHash();
  PointsQuery query;
  query.with_hessians = *at++ != 0;
  const size_t count = CountAt(at);
  if (absl::Status status = CheckNumPoints(count, query.with_hessians); !status.ok()) return status;
  const uint8_t* const x_m = at + kCountBytes;
  const uint8_t* const y_m = x_m + count * sizeof(double);
  query.points_m.resize(count);
  Eigen::Vector2d* const point_m = query.points_m.data();
  for (size_t k = 0; k < count; ++k) point_m[k] = {DoubleAt(x_m, k), DoubleAt(y_m, k)};
  return query;
}

std::vector<uint8_t> EncodeReply(const PointsQuery::Answer& answer, const reply_t& header) {
  points_reply_t empty{};
  empty.header = header;
  const size_t count = answer.samples.size();
  const size_t num_hessians = answer.hessians_per_m2.size();
  const auto empty_bytes = static_cast<size_t>(empty.getEncodedSize());
  std::vector<uint8_t> bytes(empty_bytes + count * kSampleBytes + num_hessians * kHessianBytes);
  empty.encode(bytes.data(), 0, static_cast<int>(empty_bytes));

  uint8_t* const counted = bytes.data() + empty_bytes - 2 * kCountBytes;
  PutCount(count, counted);
  const Arrays<uint8_t> samples(counted + kCountBytes, count);
  const SurfaceSample* const sample = answer.samples.data();
  for (size_t k = 0; k < count; ++k) {
    Put(sample[k].log_odds, samples.first, k);
    Put(sample[k].gradient_per_m.x(), samples.second, k);
    Put(sample[k].gradient_per_m.y(), samples.third, k);
    samples.end[k] = sample[k].known ? 1 : 0;
  }
  uint8_t* const counted_hessians = samples.end + count;
  PutCount(num_hessians, counted_hessians);
  const Arrays<uint8_t> hessians(counted_hessians + kCountBytes, num_hessians);
  for (size_t k = 0; k < num_hessians; ++k) {
    const Eigen::Matrix2d& hessian = answer.hessians_per_m2[k];
    Put(hessian(0, 0), hessians.first, k);
    Put(hessian(0, 1), hessians.second, k);
    Put(hessian(1, 1), hessians.third, k);
  }
  return bytes;
}

absl::StatusOr<reply_t> HandleReply(absl::Span<const uint8_t> message, const PointsQuery& query,
                                    Chunk chunk, PointsQuery::Answer& answer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckTypeAndSize(MessageType::kPointsReply, message));
  reply_t header;
  const int header_bytes = header._decodeNoHash(
      message.data(), kFingerprintBytes, static_cast<int>(message.size() - kFingerprintBytes));
  SPLINEMAP_RETURN_IF_ERROR(CheckLayerId({header.name, 0}));
  if (header.status != 0) return header;
  const uint8_t* const counted = message.data() + kFingerprintBytes + header_bytes;
  const size_t count = CountAt(counted);
  const uint8_t* const counted_hessians = counted + kCountBytes + count * kSampleBytes;
  const size_t num_hessians = CountAt(counted_hessians);
  if (count != chunk.size() || num_hessians != (query.with_hessians ? count : 0)) {
    return InvalidArgument("a reply of {} points and {} second derivatives to a request of {}",
                           count, num_hessians, chunk.size());
  }
  answer.revision = static_cast<uint64_t>(header.revision);
  answer.samples.resize(query.points_m.size());
  const Arrays<const uint8_t> samples(counted + kCountBytes, count);
  SurfaceSample* const sample = answer.samples.data() + chunk.begin;
  for (size_t k = 0; k < count; ++k) {
    sample[k] = {{DoubleAt(samples.second, k), DoubleAt(samples.third, k)},
                 DoubleAt(samples.first, k),
                 samples.end[k] != 0};
  }
  if (!query.with_hessians) return header;
  answer.hessians_per_m2.resize(query.points_m.size());
  const Arrays<const uint8_t> hessians(counted_hessians + kCountBytes, count);
  for (size_t k = 0; k < count; ++k) {
    const double xy = DoubleAt(hessians.second, k);
    answer.hessians_per_m2[chunk.begin + k] << DoubleAt(hessians.first, k), xy, xy,
        DoubleAt(hessians.third, k);
  }
  return header;
}

}  // namespace splinemap
