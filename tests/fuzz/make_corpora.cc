// Writes the corpora that are not text: fuzz_corpora FOLDER makes FOLDER/TARGET/NAME, synthetic.

#include <SQLiteCpp/SQLiteCpp.h>
#include <zlib.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/scan_record_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/archive/scan_record.h"
#include "lib/logs/lcm_log.h"
#include "lib/replication/protocol.h"
#include "lib/rpc/encoded.h"
#include "lib/tiles/tile_codec.h"
#include "lib/wire/encode.h"
#include "splinemap/file.h"
#include "tests/fuzz/fuzz.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"
#include "tests/support/test_keys.h"

namespace splinemap {
namespace {

class CorpusMaker {
 public:
  explicit CorpusMaker(std::string folder) : folder_(std::move(folder)) {}

  void Make() {
    Messages();
    Tiles();
    ScanRecords();
    MapperPrograms();
    SurveyPrograms();
    GzippedCarmenLog();
    LcmLogs();
    MapRecordPrograms();
    MapFiles();
  }

 private:
  template <typename Bytes>
  void Write(const std::string& name, const Bytes& bytes) {
    const std::filesystem::path path = folder_ + "/" + name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
  }

  // As message.cc takes them: a byte of options and no fingerprint.
  template <typename Message>
  void WriteMessage(const std::string& name, uint8_t options, const Message& message) {
    WriteEncoded(name, options, Encode(message));
  }
  void WriteEncoded(const std::string& name, uint8_t options, std::vector<uint8_t> bytes) {
    bytes.erase(bytes.begin(), bytes.begin() + 7);
    bytes[0] = options;
    Write(name, bytes);
  }

  void Messages() {
    const Utime utime = std::chrono::seconds(1);
    WriteMessage("planar_lidar/five_beams", 0x55,
                 PlanarLidarMessage(utime, {0, 0.5, 1, 20, 1e9F}, -1, 0.5));
    WriteMessage("planar_lidar/no_beam", 0x2a, PlanarLidarMessage(utime, {}, 0, 0));
    WriteMessage("pose/turned", 0, PoseMessage({utime, {{1, -2}, 0.7}}));

    michigan::lidar_t lidar{};
    lidar.utime = utime.count();
    WriteMessage("michigan_lidar/no_beam", 0, lidar);
    lidar.num_ranges = 3;
    lidar.ranges = {1, 2, 0};
    lidar.thetas = {0, 1, 2};
    lidar.times = {1'000'000, 1'050'000, 1'100'000};
    lidar.intensities = {0, 1, 2};
    WriteMessage("michigan_lidar/three_beams", 0xff, lidar);
    WriteMessage("michigan_lidar/three_beams_no_times", 0x04, lidar);

    michigan::pose_xyt_t pose{};
    pose.utime = utime.count();
    pose.x = 1;
    pose.theta = -3;
    WriteMessage("michigan_pose/turned", 0, pose);

    bot_core::rigid_transform_t mount{};
    mount.utime = utime.count();
    mount.trans[0] = 0.2;
    mount.quat[0] = 1;
    WriteMessage("rigid_transform/level", 0, mount);
    mount.quat[0] = 0;
    mount.quat[2] = 1;
    WriteMessage("rigid_transform/upside_down", 0, mount);

    status_t status{};
    status.utime = utime.count();
    status.name = "robot";
    status.num_drop_reasons = 2;
    status.drop_reasons = {"late_scan", "overload"};
    status.drop_counts = {1, 2};
    WriteMessage("status/two_reasons", 0, status);
    status.num_problems = 1;
    status.problems = {"silence"};
    status.problem_counts = {3};
    WriteMessage("status/problem", 0, status);
    LayerMessages();
    RpcMessages();
  }

  void LayerMessages() {
    layer_ref_t layer{};
    layer.name = "robot";
    layer.origin = 1;
    layer.session_number = 2;
    layer.session_nonce = 3;

    layer_digest_t digest{};
    digest.speaker = 3;
    digest.layer = layer;
    digest.protocol_version = kProtocolVersion;
    digest.knot_interval_m = 0.05;
    digest.min_control_point = -2560;
    digest.max_control_point = 2560;
    digest.root_level = 1;
    WriteMessage("layer_digest/empty", 0, digest);

    digest.speaker = 4;
    WriteMessage("layer_digest/of_proxy", 0, digest);
    const auto robot = *KeyRing::Make(TestSecret(1), {});
    Write("admission/of_proxy", SignedMessage(robot.get(), digest));
    Write("admission/of_stranger", SignedMessage(KeyRing::Make(TestSecret(2), {})->get(), digest));
    Write("admission/unsigned", Encode(digest));

    trajectory_t trajectory{};
    trajectory.num_parts = 1;
    trajectory.num_poses = 2;
    trajectory.pose_utime = {1, 2};
    trajectory.x_m = trajectory.y_m = trajectory.yaw_rad = {0, 1};
    WriteMessage("trajectory/whole", 0, trajectory);
    trajectory.num_parts = 2;
    trajectory.robot = "robot";
    WriteMessage("trajectory/part", 0, trajectory);

    settings_t settings{};
    WriteMessage("settings/none", 0, settings);
    settings.num_layers = 2;
    settings.layers.resize(2);
    for (layer_settings_t& one : settings.layers) {
      one = {};
      one.name = "robot";
    }
    WriteMessage("settings/two", 0, settings);
    Write("admission/settings", SignedMessage(robot.get(), settings));

    layers_t layers{};
    layers.name = "robot";
    layers.num_refused = 1;
    layers.refused = {"other"};
    layers.num_layers = 2;
    layers.layers.resize(2);
    for (layer_status_t& status : layers.layers) {
      status = {};
      status.settings.name = "robot";
      status.state = "live";
    }
    WriteMessage("layers/two", 0, layers);

    layer_updates_t updates{};
    updates.speaker = 3;
    updates.layer = layer;
    WriteMessage("layer_updates/none", 0, updates);
    updates.num_tiles = 2;
    for (int32_t n = 0; n < 2; ++n) {
      const std::string content = EncodeTile(Tile{});
      tile_update_t update{};
      update.tx = n;
      update.revision = 1;
      update.content.assign(content.begin(), content.end());
      update.num_bytes = static_cast<int32_t>(content.size());
      updates.tiles.push_back(update);
    }
    WriteMessage("layer_updates/two_tiles", 0, updates);
    Write("admission/updates", SignedMessage(robot.get(), updates));

    layer_listing_t listing{};
    listing.speaker = 3;
    listing.layer = layer;
    listing.num_nodes = 2;
    listing.nodes.resize(2);
    listing.nodes[0].level = 1;
    listing.nodes[0].num_children = 2;
    listing.nodes[0].children = {0, 63};
    listing.nodes[0].hashes = {5, 6};
    listing.nodes[0].revisions = {1, 2};
    WriteMessage("layer_listing/two_nodes", 0, listing);

    layer_pull_t pull{};
    pull.speaker = 5;
    pull.layer = layer;
    pull.num_nodes = 2;
    pull.levels = {0, 1};
    pull.xs = {-1, 0};
    pull.ys = {3, -1};
    WriteMessage("layer_pull/tile_and_node", 0, pull);

    layer_scans_t scans{};
    scans.speaker = 3;
    scans.layer = layer;
    scans.oldest = 7;
    scans.num_scans = 2;
    for (int16_t part = 0; part < 2; ++part) {
      scan_record_t record{};
      record.revision = 9;
      record.utime = 1'000'000;
      record.robot_x = -(1 << 20);
      record.robot_yaw = 5;
      record.part = part;
      record.num_parts = 2;
      record.num_bytes = 3;
      record.content = {1, 2, 3};
      scans.scans.push_back(record);
    }
    WriteMessage("layer_scans/two_parts", 0, scans);

    scan_pull_t scan_pull{};
    scan_pull.speaker = 5;
    scan_pull.layer = layer;
    scan_pull.num_ranges = 2;
    scan_pull.first = {3, 9};
    scan_pull.last = {3, 12};
    WriteMessage("scan_pull/two_ranges", 0, scan_pull);
  }

  template <typename Query>
  void WriteRequest(const std::string& name, const Query& query, size_t size) {
    request_t header{};
    header.client = 1;
    header.id = 2;
    WriteEncoded(name, 1, EncodeRequest(query, {0, size}, header));
  }
  template <typename Answer>
  void WriteReply(const std::string& name, const Answer& answer, uint8_t asked) {
    reply_t header{};
    header.name = "robot";
    WriteEncoded(name, asked, EncodeReply(answer, header));
  }

  void RpcMessages() {
    const std::vector<Eigen::Vector2d> points_m{{0.1, 0.2}, {-1, 0.5}};
    WriteRequest("points_request/two", PointsQuery{points_m, true}, 2);
    WriteRequest("points_request/none", PointsQuery{}, 0);
    WriteRequest("rays_request/two", RaysQuery{{{{0, 0}, 1, 2}, {{1, 1}, -2, 30}}}, 2);
    WriteRequest("rays_request/passing", RaysQuery{{{{0, 0}, 1, 2}}, 0.5, UnknownPolicy::kFree}, 1);
    WriteRequest("sweeps_request/two", SweepsQuery{{{points_m, 0.2}, {{{1, 1}}, 0}}}, 2);
    WriteRequest("raster_request/part", RasterQuery{{-1, -1}, 0.1, 20, 30}, 50);
    WriteRequest("likelihoods_request/two", LikelihoodsQuery{points_m, {{}, {{1, 1}, 2}}}, 2);
    WriteRequest("distances_request/two", DistancesQuery{points_m}, 2);

    PointsQuery::Answer points;
    points.samples.resize(2);
    WriteReply("points_reply/two", points, 4);
    points.hessians_per_m2.resize(2);
    WriteReply("points_reply/hessians", points, 3);
    WriteReply("rays_reply/two", RaysQuery::Answer{1, {{Occupancy::kOccupied, 2}, {}}}, 4);
    SweepsQuery::Answer sweeps;
    sweeps.results.resize(2);
    WriteReply("sweeps_reply/two", sweeps, 4);
    WriteReply("raster_reply/three", RasterQuery::Answer{1, {0, 1, -5}}, 6);
    WriteReply("likelihoods_reply/two", LikelihoodsQuery::Answer{1, {-1, -2.5}}, 4);
    DistancesQuery::Answer distances;
    distances.distances.resize(2);
    WriteReply("distances_reply/two", distances, 4);

    command_request_t command{};
    command.command = "clear";
    command.session_number = 3;
    WriteMessage("command_request/clear", 0, command);
    layer_command_request_t layer_command{};
    layer_command.command = "remove";
    layer_command.name = "robot";
    WriteMessage("layer_command_request/remove", 0, layer_command);
    command_reply_t reply{};
    reply.header.name = "robot";
    reply.header.status = 9;
    reply.header.status_text = "the command is for start 3";
    WriteMessage("command_reply/refused", 0, reply);
  }

  void Tiles() {
    std::mt19937_64 random(1);
    Tile tile;
    Write("tile/zeros", EncodeTile(tile));
    for (int k = 0; k < Tile::kSize; k += 7) tile.control_points[k] = static_cast<ControlPoint>(k);
    Write("tile/steps", EncodeTile(tile));
    tile.control_points[0] = -25'600;
    Write("tile/short", EncodeTile(tile).substr(0, 30));
    Write("tile/random", EncodeTile(RandomTile(random)));
  }

  void ScanRecords() {
    PosedScan scan;
    scan.robot_T_sensor = {FixedPose2::Nearest({{0.2, 0}, 0.1})};
    Write("scan_record/no_beam", PackBeams(scan, {}));
    for (uint16_t k = 0; k < 12; ++k) {
      scan.beams.push_back({2.0F + 0.01F * static_cast<float>(k * k % 7),
                            static_cast<float>(0.25 * k),
                            {},
                            k % 5 != 4,
                            static_cast<uint16_t>(k + k / 6)});
    }
    Write("scan_record/floats", PackBeams(scan, {}));
    for (Beam& beam : scan.beams) {
      beam.range_m = static_cast<float>(std::round(100 * beam.range_m) * 0.01);
      beam.bearing_rad = 0.25F * static_cast<float>(beam.reading);
    }
    Write("scan_record/line", PackBeams(scan, {}));
    scan.channel = 3;
    scan.robot_T_sensor.clear();
    for (size_t k = 0; k < scan.beams.size(); ++k) {
      Beam& beam = scan.beams[k];
      beam.bearing_rad =
          static_cast<float>(k * k % 5 + 64 * k) / 64 * static_cast<float>(std::acos(-1.0) / 180);
      const double time_s = 0.002 * static_cast<double>(k + k / 5);
      scan.robot_T_sensor.push_back(FixedPose2::Nearest({{time_s, 0.1 * time_s}, 0.2 * time_s}));
    }
    BeamModelOptions model;
    model.update = BeamUpdate::kPaperLine;
    Write("scan_record/moving", PackBeams(scan, model));
  }

  using Program = std::vector<uint8_t>;

  static void Add(Program& program, const Program& step) {
    program.insert(program.end(), step.begin(), step.end());
  }

  // Steps as mapper.cc and messages.cc read them: whether to flush, channel, kind, step of time,
  // then numbers.
  void MapperPrograms() {
    enum Channel : uint8_t { kPose, kAuto, kBot, kFirst, kLast, kMount };
    const auto pose = [](uint8_t step, uint8_t x) { return Program{0, kPose, 0, step, x, 4, 1}; };
    const auto scan = [](uint8_t channel, uint8_t step) {
      return Program{0, channel, 2, step, 5, 4, 8, 0, 20, 80, 252, 2};
    };
    const auto michigan_scan = [](uint8_t channel, uint8_t step) {
      return Program{0, channel, 3, step, 3, 4, 0, 0, 8, 1, 1, 12, 2, 1};
    };
    Program program{0, kMount, 4, 1, 1, 0, 0, 4, 1};
    for (uint8_t k = 0; k < 8; ++k) {
      Add(program, pose(5, k));
      Add(program, scan(k % 2 == 0 ? kAuto : kBot, 2));
      Add(program, michigan_scan(k % 2 == 0 ? kFirst : kLast, 3));
    }
    Write("mapper/all_channels", program);
    Add(program, pose(static_cast<uint8_t>(-127), 1));  // time goes back
    Add(program, pose(static_cast<uint8_t>(-127), 2));
    for (uint8_t k = 0; k < 4; ++k) {
      Add(program, scan(kAuto, 1));
      Add(program, pose(2, k));
    }
    Add(program, {255, kPose, 6, 0, 4, 1, 2, 3, 4});  // raw bytes, and a flush
    Write("mapper/rewound", program);
  }

  // Steps as survey.cc and messages.cc read them: lag, channel, kind, step of time, then numbers;
  // or a drive: channel, scans, turn.
  void SurveyPrograms() {
    enum Channel : uint8_t { kPose, kScan, kOdometry, kRear };
    Program program{0};
    constexpr uint8_t kDrive = 0x80;
    Add(program, {kDrive, kScan, 19, 4});  // 7.6 s, of which 4.6 s are used: 11 scans
    Add(program, {kDrive, kRear, 19, 4});
    Write("survey/two_scanners", program);
    Program odd{0, kDrive, kScan, 139, 4};
    for (uint8_t k = 0; k < 8; ++k) Add(odd, {k, kOdometry, 1, 200, k, 0, k});
    Add(odd, {255, 0, 0, 0, 0, 0, 0, 0, 127, kOdometry, 1, 1, 1, 1, 1});  // a log's time of 2^63
    Add(odd, {1, kRear, 4, 1, 1, 0, 0, 4, 1});
    Write("survey/two_poses", odd);
  }

  void GzippedCarmenLog() {
    const std::string path = folder_ + "/carmen_log/gzip";
    std::filesystem::create_directories(folder_ + "/carmen_log");
    const gzFile file = gzopen(path.c_str(), "wb9");
    for (int k = 0; k < 3; ++k) {
      gzprintf(file, "FLASER 4 1 1.5 2 81.9 0.%d 0 0 0 0 0 %d.5 host %d.5\n", k, k, k);
    }
    Require(gzclose(file) == Z_OK, "a gzip file is written");
  }

  void LcmLogs() {
    std::filesystem::create_directories(folder_ + "/lcm_log");
    const std::string path = folder_ + "/lcm_log/plain";
    auto writer = LcmLogWriter::Create(path);
    for (int k = 0; k < 3; ++k) {
      std::vector<uint8_t> message(static_cast<size_t>(4 * k), 0xED);
      Require(writer->WriteBytes(Utime(k), "POSE", message).ok(), "an event is written");
    }
    Require(writer->Close().ok(), "a log is written");
    std::ifstream in(path, std::ios::binary);
    std::string log(std::istreambuf_iterator<char>(in), {});
    const gzFile file = gzopen((folder_ + "/lcm_log/gzip").c_str(), "wb9");
    gzwrite(file, log.data(), static_cast<unsigned>(log.size()));
    Require(gzclose(file) == Z_OK, "a gzip file is written");
    log[32] = 0;  // the sync word of the second event
    Write("lcm_log/damaged", log);
    Write("lcm_log/cut", log.substr(0, log.size() - 5));
  }

  // Bytes as map_records.cc reads them: a map of one layer "b" with two tiles, one of them twice.
  void MapRecordPrograms() {
    std::vector<uint8_t> program{0, 1, 100, 0, 100, 1};
    const std::vector<uint8_t> layer{2, 1, 1, 1, 1, 2, 1, 1};
    program.insert(program.end(), layer.begin(), layer.end());
    for (const uint8_t key : std::vector<uint8_t>{2, 7, 7}) {
      const std::vector<uint8_t> tile{4, 1, key, 1, key};
      program.insert(program.end(), tile.begin(), tile.end());
    }
    Write("map_records/two_tiles", program);
    const std::vector<uint8_t> raw_tile{5, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 3, 1, 2, 3};
    program.insert(program.end(), raw_tile.begin(), raw_tile.end());
    Write("map_records/raw_tile", program);
  }

  void MapFiles() {
    std::filesystem::create_directories(folder_ + "/map_file");
    const std::string path = folder_ + "/map_file/two_layers";
    std::filesystem::remove(path);
    MapWriter map({});
    for (const uint64_t origin : {1, 2}) {
      Layer& layer = map.AddLayer({"robot", origin}, {1, 1});
      layer.BeginCommit();
      for (int tx = -1; tx < 2; ++tx) layer.EditTile({tx, 5}).control_points.fill(300);
    }
    auto file = MapFile::Open(path);
    Require(file.ok() && file->Save(map.Layers()).ok() && file->Close().ok(), "a map is saved");
    std::ifstream in(path, std::ios::binary);
    const std::string bytes(std::istreambuf_iterator<char>(in), {});
    Write("map_file/cut", bytes.substr(0, bytes.size() / 2));
  }

  std::string folder_;
};

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  splinemap::Require(argc == 2, "usage: fuzz_corpora FOLDER");
  splinemap::CorpusMaker(argv[1]).Make();
}
