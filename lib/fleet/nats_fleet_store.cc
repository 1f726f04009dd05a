#include "lib/fleet/nats_fleet_store.h"

#include <nats/nats.h>

#include <chrono>
#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/fleet/nats_connection.h"
#include "lib/fleet/nats_handle.h"
#include "lib/fleet/nats_subscription.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kReadTimeout(2000);  // whoever reads asks again
constexpr milliseconds kStraggle(500);
constexpr const char* kHashHeader = "Splinemap-Hash";
constexpr int32_t kMaxValueBytes = 1 << 20;  // what servers take unless told otherwise

std::string ValueOf(natsMsg* message) {
  return {natsMsg_GetData(message), static_cast<size_t>(natsMsg_GetDataLength(message))};
}

std::string HeaderOf(natsMsg* message, const char* name) {
  const char* value = nullptr;
  return natsMsgHeader_Get(message, name, &value) == NATS_OK && value != nullptr ? value : "";
}

uint64_t NumberOf(const std::string& text, int base) {
  uint64_t number = 0;
  if (base == 16) return absl::SimpleHexAtoi(text, &number) ? number : 0;
  return absl::SimpleAtoi(text, &number) ? number : 0;
}

// Of a message that says or writes an entry.
FleetEntry EntryOf(natsMsg* message, std::string key, uint64_t revision) {
  FleetEntry entry;
  entry.key = std::move(key);
  entry.revision = revision;
  if (!HeaderOf(message, "KV-Operation").empty()) return entry;  // it was removed
  entry.value = ValueOf(message);
  entry.hash = NumberOf(HeaderOf(message, kHashHeader), 16);
  return entry;
}

// A message that writes an entry; null where there is no memory for it.
NatsHandle<natsMsg> MessageOf(const std::string& subject, const FleetEntry& entry) {
  natsMsg* made = nullptr;
  natsMsg_Create(&made, subject.c_str(), nullptr, entry.value.data(),
                 static_cast<int>(entry.value.size()));
  NatsHandle<natsMsg> message(made);
  if (message && entry.value.empty()) {
    natsMsgHeader_Set(made, "KV-Operation", "DEL");
  } else if (message) {
    natsMsgHeader_Set(made, kHashHeader, fmt::format("{:x}", entry.hash).c_str());
  }
  return message;
}

}  // namespace

absl::StatusOr<std::unique_ptr<NatsFleetStore>> NatsFleetStore::Connect(
    const FleetAddress& address) {
  SPLINEMAP_ASSIGN_OR_RETURN(NatsConnection* const connection, NatsConnection::Connect(address));
  return std::unique_ptr<NatsFleetStore>(new NatsFleetStore(*connection));
}

NatsFleetStore::~NatsFleetStore() { connection_.Close(); }

const FleetAddress& NatsFleetStore::address() const { return connection_.address(); }
uint64_t NatsFleetStore::connections() const { return connection_.connections(); }
bool NatsFleetStore::IsClosed() const { return connection_.IsClosed(); }
std::string NatsFleetStore::Problem() const { return connection_.Problem(); }

std::string NatsFleetStore::SubjectOf(const std::string& key) const {
  return "$KV." + address().Bucket() + "." + key;
}

absl::Status NatsFleetStore::MakeBucket(int replicas) {
  const Clock::time_point begin = Clock::now();
  jsStreamConfig config;
  jsStreamConfig_Init(&config);
  const std::string name = address().Stream();
  const std::string subject = SubjectOf(">");
  const char* subjects[] = {subject.c_str()};
  const std::string stored = fmt::format("splinemap.{}.stored.>", address().map);
  jsRePublish republish{subject.c_str(), stored.c_str(), false};
  config.Name = name.c_str();
  config.Subjects = subjects;
  config.SubjectsLen = 1;
  config.MaxMsgsPerSubject = 1;
  config.MaxMsgSize = kMaxValueBytes;
  config.Discard = js_DiscardNew;
  config.Storage = js_FileStorage;
  config.Replicas = replicas;
  // Whoever may write one key could remove all others: by a rollup, or by an acknowledgement that
  // goes to where purges are asked for.
  config.DenyDelete = true;
  config.DenyPurge = true;
  config.AllowRollup = false;
  config.RePublish = &republish;
  jsStreamInfo* info = nullptr;
  jsErrCode error = static_cast<jsErrCode>(0);
  natsStatus status = js_GetStreamInfo(&info, connection_.context(), name.c_str(), nullptr, &error);
  if (status != NATS_OK) {
    status = js_AddStream(&info, connection_.context(), &config, nullptr, &error);
  }
  jsStreamInfo_Destroy(info);
  return connection_.StatusOf(status, fmt::format("to make the map '{}'", address().map), begin);
}

absl::Status NatsFleetStore::Put(absl::Span<const FleetEntry> entries) {
  const Clock::time_point begin = Clock::now();
  std::vector<NatsHandle<natsMsg>> messages;
  for (const FleetEntry& entry : entries) {
    messages.push_back(MessageOf(SubjectOf(entry.key), entry));
  }
  jsPubOptions options;
  jsPubOptions_Init(&options);
  return connection_.StatusOf(connection_.Write(std::move(messages), options), "to write", begin);
}

absl::StatusOr<uint64_t> NatsFleetStore::PutIf(const FleetEntry& entry, uint64_t expected) {
  const Clock::time_point begin = Clock::now();
  jsPubOptions options;
  jsPubOptions_Init(&options);
  options.ExpectLastSubjectSeq = expected;
  options.ExpectNoMessage = expected == 0;
  std::vector<NatsHandle<natsMsg>> messages;
  messages.push_back(MessageOf(SubjectOf(entry.key), entry));
  const NatsAcknowledgements::Outcome outcome = connection_.Write(std::move(messages), options);
  if (outcome.code == JSStreamWrongLastSequenceErr) {
    return absl::AbortedError(fmt::format("{} was written by somebody else", entry.key));
  }
  SPLINEMAP_RETURN_IF_ERROR(connection_.StatusOf(outcome, "to write " + entry.key, begin));
  return outcome.revision;
}

absl::StatusOr<FleetEntry> NatsFleetStore::Get(const std::string& key_or_filter) {
  const Clock::time_point begin = Clock::now();
  jsOptions options;
  jsOptions_Init(&options);
  options.Wait = kReadTimeout.count();
  natsMsg* message = nullptr;
  jsErrCode error = static_cast<jsErrCode>(0);
  const natsStatus status =
      js_GetLastMsg(&message, connection_.context(), address().Stream().c_str(),
                    SubjectOf(key_or_filter).c_str(), &options, &error);
  const NatsHandle<natsMsg> owned(message);
  if (error == JSNoMessageFoundErr || (status == NATS_NOT_FOUND && error != JSStreamNotFoundErr)) {
    return absl::OutOfRangeError(
        fmt::format("the map '{}' has no {}", address().map, key_or_filter));
  }
  if (status != NATS_OK) return connection_.StatusOf(status, "to read " + key_or_filter, begin);
  const std::string prefix = SubjectOf("");
  const std::string subject = natsMsg_GetSubject(message);
  if (!absl::StartsWith(subject, prefix)) return DataLoss("{} is of another bucket", subject);
  return EntryOf(message, subject.substr(prefix.size()), natsMsg_GetSequence(message));
}

absl::Status NatsFleetStore::List(const std::string& filter, bool with_values,
                                  absl::FunctionRef<void(FleetEntry entry)> visit) {
  const Clock::time_point begin = Clock::now();
  // A consumer of its own that ends with the list. Acknowledged by nothing but flow control.
  const std::string what = "to list " + filter;
  const std::string prefix = SubjectOf("");
  jsSubOptions options;
  jsSubOptions_Init(&options);
  const std::string stream = address().Stream();
  options.Stream = stream.c_str();
  options.Ordered = true;
  options.Config.DeliverPolicy = js_DeliverLastPerSubject;
  options.Config.HeadersOnly = !with_values;
  natsSubscription* made = nullptr;
  jsErrCode error = static_cast<jsErrCode>(0);
  natsStatus status = js_SubscribeSync(&made, connection_.context(), SubjectOf(filter).c_str(),
                                       nullptr, &options, &error);
  if (status != NATS_OK) return connection_.StatusOf(status, what, begin);
  const NatsHandle<natsSubscription> subscription(made);
  natsSubscription_SetPendingLimits(made, -1, -1);
  jsConsumerInfo* info = nullptr;
  status = natsSubscription_GetConsumerInfo(&info, made, nullptr, &error);
  if (status != NATS_OK) return connection_.StatusOf(status, what, begin);
  uint64_t left = info->NumPending + info->Delivered.Consumer;
  jsConsumerInfo_Destroy(info);
  for (bool is_over = left == 0, has_ended = false; !is_over;) {
    natsMsg* raw = nullptr;
    status = natsSubscription_NextMsg(&raw, made,
                                      (has_ended ? kStraggle : NatsConnection::kTimeout).count());
    if (has_ended && status == NATS_TIMEOUT) {
      status = NATS_OK;
      is_over = true;
    }
    if (status != NATS_OK || is_over) break;
    const NatsHandle<natsMsg> message(raw);
    jsMsgMetaData* meta = nullptr;
    if (natsMsg_GetMetaData(&meta, raw) != NATS_OK) continue;
    // Servers may say so before all has come that they had at the beginning.
    has_ended = meta->NumPending == 0;
    left -= left > 0 ? 1 : 0;
    is_over = has_ended && left == 0;
    const uint64_t sequence = meta->Sequence.Stream;
    jsMsgMetaData_Destroy(meta);
    const std::string subject = natsMsg_GetSubject(raw);
    if (!absl::StartsWith(subject, prefix)) continue;
    visit(EntryOf(raw, subject.substr(prefix.size()), sequence));
  }
  natsSubscription_Unsubscribe(made);
  return connection_.StatusOf(status, what, begin);
}

absl::StatusOr<std::unique_ptr<FleetSubscription>> NatsFleetStore::Subscribe(
    const std::string& filter, Handler handler) {
  const Clock::time_point begin = Clock::now();
  const std::string prefix = fmt::format("splinemap.{}.stored.", address().map);
  auto subscription =
      std::make_unique<NatsSubscription>([prefix, handler = std::move(handler)](natsMsg* message) {
        const std::string subject = natsMsg_GetSubject(message);
        const uint64_t sequence = NumberOf(HeaderOf(message, "Nats-Sequence"), 10);
        if (!absl::StartsWith(subject, prefix) || sequence == 0) return;
        handler(EntryOf(message, subject.substr(prefix.size()), sequence));
      });
  const natsStatus status = subscription->Begin(connection_.get(), prefix + filter, "");
  if (status != NATS_OK) return connection_.StatusOf(status, "to follow " + filter, begin);
  // So that what is stored after this comes.
  if (const natsStatus flushed =
          natsConnection_FlushTimeout(connection_.get(), NatsConnection::kTimeout.count());
      flushed != NATS_OK) {
    return connection_.StatusOf(flushed, "to follow " + filter, begin);
  }
  return subscription;
}

absl::StatusOr<std::string> NatsFleetStore::Request(const std::string& subject,
                                                    const std::string& request,
                                                    milliseconds deadline) {
  const Clock::time_point begin = Clock::now();
  natsMsg* reply = nullptr;
  const natsStatus status = natsConnection_Request(&reply, connection_.get(), subject.c_str(),
                                                   request.data(), static_cast<int>(request.size()),
                                                   std::max<int64_t>(deadline.count(), 1));
  const NatsHandle<natsMsg> owned(reply);
  if (status == NATS_NO_RESPONDERS) {
    return Unavailable("no splinemap-fleet-worker answers for the map '{}'", address().map);
  }
  if (status == NATS_TIMEOUT) {
    return absl::DeadlineExceededError("the fleet's workers did not answer in time");
  }
  if (status != NATS_OK) return connection_.StatusOf(status, "to ask", begin);
  return ValueOf(reply);
}

absl::StatusOr<std::unique_ptr<FleetSubscription>> NatsFleetStore::Serve(const std::string& subject,
                                                                         const std::string& queue,
                                                                         Question question) {
  const Clock::time_point begin = Clock::now();
  auto subscription =
      std::make_unique<NatsSubscription>([question = std::move(question)](natsMsg* message) {
        const char* const reply_to = natsMsg_GetReply(message);
        // Whoever asks chooses where the reply goes, and could have it stored.
        if (reply_to == nullptr || !absl::StartsWith(reply_to, NatsSubscription::kInboxes)) return;
        question(ValueOf(message), reply_to);
      });
  const natsStatus status = subscription->Begin(connection_.get(), subject, queue);
  if (status != NATS_OK) return connection_.StatusOf(status, "to answer " + subject, begin);
  return subscription;
}

absl::Status NatsFleetStore::Tell(const std::string& subject, const std::string& message) {
  const Clock::time_point begin = Clock::now();
  return connection_.StatusOf(
      natsConnection_Publish(connection_.get(), subject.c_str(), message.data(),
                             static_cast<int>(message.size())),
      "to tell " + subject, begin);
}

absl::StatusOr<std::unique_ptr<FleetSubscription>> NatsFleetStore::Listen(
    const std::string& subject, std::function<void(const std::string& message)> handler) {
  const Clock::time_point begin = Clock::now();
  auto subscription = std::make_unique<NatsSubscription>(
      [handler = std::move(handler)](natsMsg* message) { handler(ValueOf(message)); });
  const natsStatus status = subscription->Begin(connection_.get(), subject, "");
  if (status != NATS_OK) return connection_.StatusOf(status, "to listen to " + subject, begin);
  return subscription;
}

}  // namespace splinemap
