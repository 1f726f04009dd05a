#include "services/splinemapd/folding_thread.h"

#include <sys/resource.h>

#include <algorithm>
#include <filesystem>
#include <future>
#include <memory>
#include <utility>

#include "lib/base/status.h"
#include "lib/mapping/fold.h"
#include "lib/wire/sensor_messages.h"

namespace splinemap {
namespace {

constexpr size_t kMaxWaitingBytes = size_t{64} << 20;
// Scans that came while others were folded are folded here, until so few are left that mapping does
// not wait for them.
constexpr int64_t kFewScans = 20;
constexpr std::chrono::seconds kLongestStep(60);
// Of trajectories that come one after the other. Each makes another session, which followers show
// when it is two seconds old and whole.
constexpr std::chrono::seconds kCorrectionInterval(5);
// Each takes some 150 bytes.
constexpr size_t kMaxSignatures = 100'000;
constexpr const char* kTrajectory = "TRAJECTORY";
constexpr const char* kPlacement = "PLACEMENT";

// Whether nothing of `older` is left after `newer`.
bool Covers(const Trajectory& newer, const Trajectory& older) {
  return newer.poses.front().utime <= older.poses.front().utime &&
         newer.poses.back().utime >= older.poses.back().utime && newer.until >= older.until;
}

}  // namespace

FoldingThread::FoldingThread(const config::Config& config, std::shared_ptr<const KeyRing> keys,
                             const MapOptions& options, std::shared_ptr<TileMemory> memory,
                             NewestMap& newest, MappingThread& mapping, NoticeLog& notices)
    : keys_(std::move(keys)),
      signing_(TrajectorySigning(config.channel_prefix(), newest.Own().session.nonce)),
      robot_(RobotName(config)),
      options_(options),
      memory_(std::move(memory)),
      folder_(std::filesystem::absolute(MapPath(config)).parent_path().string()),
      forget_after_(static_cast<int64_t>(config.service().forget_after_min() * 60e6)),
      newest_(newest),
      mapping_(mapping),
      notices_(notices),
      mailbox_(kMaxWaitingBytes),
      trajectory_parts_(RobotName(config)) {}

void FoldingThread::Start() {
  folding_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

void FoldingThread::Run(const std::stop_token& stop) {
  stop_ = stop;
  // Of this thread alone, on Linux: what is new comes first.
  constexpr int kNice = 10;
  setpriority(PRIO_PROCESS, 0, kNice);
  const auto step = std::chrono::duration_cast<Clock::duration>(
      forget_after_ == Utime(0)
          ? Utime(std::chrono::hours(24))
          : std::clamp<Utime>(forget_after_ / 20, std::chrono::seconds(1), kLongestStep));
  Clock::time_point next_forgetting = Clock::now() + step;
  while (!stop.stop_requested()) {
    const auto next_correction =
        trajectory_ ? std::max(next_correction_, Clock::now()) : Clock::time_point::max();
    const auto item = mailbox_.Pop(stop, std::min(next_correction, next_forgetting));
    if (stop.stop_requested()) return;
    if (!item && trajectory_ && Clock::now() >= next_correction_) FoldTrajectory();
    if (!item && Clock::now() >= next_forgetting) {
      if (forget_after_ > Utime(0)) ForgetWhatIsOld();
      next_forgetting = Clock::now() + step;
    }
    if (!item) continue;
    if (const auto* task = std::get_if<Task>(&*item)) (*task)();
    if (const auto* message = std::get_if<MailboxMessage>(&*item)) {
      if (message->channel == kTrajectory) ReceiveTrajectory(message->bytes);
      if (message->channel == kPlacement) ReceivePlacement(message->bytes);
    }
  }
}

void FoldingThread::Fold(std::string what, EditOf edit_of, Done done) {
  mailbox_.Post([this, what = std::move(what), edit_of = std::move(edit_of),
                 done = std::move(done)] { FoldNow(what, edit_of, done); });
}

void FoldingThread::HandleTrajectory(absl::Span<const uint8_t> message) {
  mailbox_.Push(kTrajectory, message);
}

void FoldingThread::HandlePlacement(absl::Span<const uint8_t> message) {
  mailbox_.Push(kPlacement, message);
}

// Each part is taken once, so that an old trajectory does not come back.
absl::Status FoldingThread::CheckSigner(absl::Span<const uint8_t> trajectory) {
  if (keys_ == nullptr) return absl::OkStatus();
  SPLINEMAP_ASSIGN_OR_RETURN(const TrustedKey* key, keys_->SignerOf(signing_, trajectory));
  if (!key->decides && !key->Maps(robot_)) {
    return absl::PermissionDeniedError(
        fmt::format("signed by {}, whose key may neither map {} nor decide", key->name, robot_));
  }
  if (signatures_.size() >= kMaxSignatures) {
    return absl::ResourceExhaustedError(fmt::format(
        "{} parts were taken, which is the most; start splinemapd again", kMaxSignatures));
  }
  const absl::Span<const uint8_t> signature = trajectory.last(kSignatureBytes);
  if (signatures_.insert(std::string(signature.begin(), signature.end())).second)
    return absl::OkStatus();
  return absl::AlreadyExistsError("");
}

void FoldingThread::ReceiveTrajectory(absl::Span<const uint8_t> message) {
  absl::Status status = CheckSigner(message);
  if (absl::IsAlreadyExists(status)) return;
  absl::StatusOr<std::optional<Trajectory>> trajectory =
      status.ok() ? trajectory_parts_.Add(message) : status;
  status = trajectory.status();
  if (trajectory.ok() && !*trajectory) return;
  if (status.ok()) status = CheckTrajectory(**trajectory);
  if (!status.ok()) {
    notices_.Report(
        {.subject = "trajectory", .text = "a trajectory was not used: " + ErrorText(status)});
    return;
  }
  if (trajectory_ && !Covers(**trajectory, *trajectory_)) FoldTrajectory();
  trajectory_ = **std::move(trajectory);
}

void FoldingThread::FoldTrajectory() {
  const auto shared = std::make_shared<Trajectory>(*std::exchange(trajectory_, std::nullopt));
  FoldNow(fmt::format("corrected by a trajectory of {} poses", shared->poses.size()),
          [shared](const ScanArchive& archive) { return CorrectBy(archive, *shared); }, {});
  next_correction_ = Clock::now() + kCorrectionInterval;
}

void FoldingThread::ReceivePlacement(absl::Span<const uint8_t> message) {
  const absl::StatusOr<Pose2> frame = DecodeFrame(message);
  if (!frame.ok()) {
    notices_.Report(
        {.subject = "placement", .text = "a placement was not used: " + ErrorText(frame.status())});
    return;
  }
  const FixedPose2 map_T_world = FixedPose2::Nearest(*frame);
  FoldNow("placed",
          [map_T_world](const ScanArchive&) -> absl::StatusOr<ArchiveEdit> {
            ArchiveEdit edit;
            edit.map_T_world = map_T_world;
            return edit;
          },
          {});
}

void FoldingThread::ForgetWhatIsOld() {
  const LayerSnapshot own = newest_.Own();
  Utime oldest = Utime::max();
  Utime newest = Utime::min();
  own.archive->ForEachPose([&](const ScanPose& pose) {
    oldest = std::min(oldest, pose.utime);
    newest = std::max(newest, pose.utime);
  });
  if (own.archive->num_scans() == 0) return;
  const Utime cutoff = newest - forget_after_;
  const ScanArchive::Base& base = own.archive->base;
  const bool base_is_old = base.newest != Utime(0) && base.newest < cutoff;
  if (oldest >= cutoff && !base_is_old) return;
  FoldNow(fmt::format("made of the scans of the last {:g} min",
                      static_cast<double>(forget_after_.count()) / 60e6),
          [cutoff](const ScanArchive& archive) { return ForgetBefore(archive, cutoff); }, {});
}

void FoldingThread::FoldNow(const std::string& what, const EditOf& edit_of, const Done& done) {
  const Clock::time_point begin = Clock::now();
  // Where another session began meanwhile, it is done once more.
  constexpr int kTries = 3;
  absl::StatusOr<std::string> result = absl::AbortedError("");
  for (int k = 0; k < kTries && absl::IsAborted(result.status()); ++k) result = TryFold(edit_of);
  if (result.ok() && !result->empty()) {
    notices_.Forget("fold");  // each is said
    notices_.Report(
        {.is_problem = false,
         .subject = "fold",
         .text = fmt::format(
             "the layer was {} in {} ms: {}", what,
             std::chrono::duration_cast<std::chrono::milliseconds>(Clock::now() - begin).count(),
             *result)});
  } else if (!result.ok() && !absl::IsCancelled(result.status())) {
    notices_.Report(
        {.subject = "fold",
         .text = fmt::format("the layer could not be {}: {}", what, ErrorText(result.status()))});
  }
  if (done) done(result.status());
}

absl::StatusOr<std::string> FoldingThread::TryFold(const EditOf& edit_of) {
  LayerSnapshot own = newest_.Own();
  const SessionId session = own.session;
  SPLINEMAP_ASSIGN_OR_RETURN(ArchiveEdit edit, edit_of(*own.archive));
  if (!edit.Changes(*own.archive)) return std::string();  // said again
  // Of a layer that does not fit into memory the new one does not either.
  std::shared_ptr<SpillFile> spill;
  if (own.tiles.size() > memory_->max_tiles() / 2) {
    SPLINEMAP_ASSIGN_OR_RETURN(spill, SpillFile::Make(folder_, memory_));
  }
  auto layer = std::make_unique<FoldedLayer>(session, std::move(edit), *own.archive, options_,
                                             std::move(spill));
  const auto is_cancelled = [this](int64_t) {
    mailbox_.steps().Add();
    return stop_.stop_requested();
  };
  do {
    own = newest_.Own();
    if (own.session != session) return absl::AbortedError("another session began");
    if (!layer->CanAppend(*own.archive)) return absl::AbortedError("scans went to the base");
    layer->Append(*own.archive);
    SPLINEMAP_RETURN_IF_ERROR(layer->Fold(is_cancelled));
    own = newest_.Own();
  } while (own.archive->scans_added() - layer->scans_added() > kFewScans);
  std::promise<absl::StatusOr<std::string>> promise;
  mapping_.TakeOver(std::move(layer), [&promise](absl::StatusOr<std::string> result) {
    promise.set_value(std::move(result));
  });
  return promise.get_future().get();
}

void FoldingThread::Stop() {
  folding_.request_stop();
  if (folding_.joinable()) folding_.join();
}

}  // namespace splinemap
