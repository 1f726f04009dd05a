#include "lib/fleet/nats_fleet_store.h"

#include <nats/nats.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/clock.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/nats_handle.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kTimeout(5000);
constexpr milliseconds kReadTimeout(2000);  // whoever reads asks again
constexpr milliseconds kStraggle(500);
constexpr const char* kHashHeader = "Splinemap-Hash";
const std::string kInboxes = "_INBOX.";  // what replies go to
// What waits for a handler in this process, before changes are dropped and counted.
constexpr int kMaxPendingMessages = 65'536;
constexpr int kMaxPendingBytes = 256 << 20;
// Of writes that are not acknowledged.
constexpr int64_t kMaxUnacknowledged = 256;
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

absl::StatusOr<NatsHandle<natsMsg>> MessageOf(const std::string& subject, const FleetEntry& entry) {
  natsMsg* made = nullptr;
  if (natsMsg_Create(&made, subject.c_str(), nullptr, entry.value.data(),
                     static_cast<int>(entry.value.size())) != NATS_OK) {
    return absl::ResourceExhaustedError("there is no memory for a message");
  }
  NatsHandle<natsMsg> message(made);
  if (entry.value.empty()) {
    natsMsgHeader_Set(message.get(), "KV-Operation", "DEL");
  } else {
    natsMsgHeader_Set(message.get(), kHashHeader, fmt::format("{:x}", entry.hash).c_str());
  }
  return message;
}

// A subscription whose handler runs in a thread of the library, and does not after the destructor.
// It hears what was said to its subject alone: a reader of the bucket may have entries delivered to
// any, but they keep the subject that they were written to.
class NatsSubscription : public FleetSubscription {
 public:
  using Handler = std::function<void(natsMsg* message)>;

  explicit NatsSubscription(Handler handler)
      : receiver_(std::make_shared<Receiver>(std::move(handler))) {}
  ~NatsSubscription() override {
    if (!subscription_) return;
    natsSubscription_Unsubscribe(subscription_.get());
    MutexLock lock(receiver_->mutex);
    receiver_->is_over = true;
  }

  natsStatus Begin(natsConnection* connection, const std::string& subject,
                   const std::string& queue) {
    receiver_->subject = subject;
    natsSubscription* made = nullptr;
    const auto handle = [](natsConnection*, natsSubscription*, natsMsg* message, void* closure) {
      const NatsHandle<natsMsg> owned(message);
      Receiver& receiver = **static_cast<std::shared_ptr<Receiver>*>(closure);
      if (!MatchesFilter(receiver.subject, natsMsg_GetSubject(message))) return;
      MutexLock lock(receiver.mutex);
      if (!receiver.is_over) receiver.handler(message);
    };
    // The library may call once more after it was told to end, and says when it does not any more.
    auto closure = std::make_unique<std::shared_ptr<Receiver>>(receiver_);
    const natsStatus status =
        queue.empty()
            ? natsConnection_Subscribe(&made, connection, subject.c_str(), handle, closure.get())
            : natsConnection_QueueSubscribe(&made, connection, subject.c_str(), queue.c_str(),
                                            handle, closure.get());
    if (status != NATS_OK) return status;
    subscription_.reset(made);
    natsSubscription_SetOnCompleteCB(
        made, [](void* over) { delete static_cast<std::shared_ptr<Receiver>*>(over); },
        closure.release());
    return natsSubscription_SetPendingLimits(made, kMaxPendingMessages, kMaxPendingBytes);
  }

 private:
  struct Receiver {
    explicit Receiver(Handler h) : handler(std::move(h)) {}
    const Handler handler;
    std::string subject;
    Mutex mutex;
    bool is_over ABSL_GUARDED_BY(mutex) = false;
  };

  const std::shared_ptr<Receiver> receiver_;
  NatsHandle<natsSubscription> subscription_;
};

}  // namespace

// Writes that are under way. Messages that were given up are acknowledged late, and ignored.
class NatsAcknowledgements {
 public:
  void Await(natsMsg* message) {
    MutexLock lock(mutex_);
    awaited_.insert(message);
  }
  // `message` is freed after this.
  void Handle(natsMsg* message, const jsPubAckErr* error) {
    MutexLock lock(mutex_);
    if (awaited_.erase(message) == 0) return;
    if (error != nullptr && status_ == NATS_OK) {
      status_ = error->Err;
      text_ = error->ErrText != nullptr ? error->ErrText : "";
    }
    changed_.notify_all();
  }
  void GiveUp(natsMsg* message) {
    MutexLock lock(mutex_);
    awaited_.erase(message);
  }
  // The servers do not allow one of them, and do not say which.
  void Refuse() {
    MutexLock lock(mutex_);
    if (awaited_.empty()) return;
    awaited_.clear();
    status_ = NATS_NOT_PERMITTED;
    changed_.notify_all();
  }
  // What became of all, or NATS_TIMEOUT where nothing came for kTimeout.
  std::pair<natsStatus, std::string> Wait() {
    MutexLock lock(mutex_);
    while (!awaited_.empty()) {
      const size_t before = awaited_.size();
      const auto end = Clock::now() + kTimeout;
      while (awaited_.size() == before && Clock::now() < end) changed_.wait_until(mutex_, end);
      if (awaited_.size() == before) {
        awaited_.clear();
        if (status_ == NATS_OK) status_ = NATS_TIMEOUT;
      }
    }
    return {std::exchange(status_, NATS_OK), std::exchange(text_, "")};
  }

 private:
  Mutex mutex_;
  ConditionVariable changed_;
  std::set<natsMsg*> awaited_ ABSL_GUARDED_BY(mutex_);
  natsStatus status_ ABSL_GUARDED_BY(mutex_) = NATS_OK;
  std::string text_ ABSL_GUARDED_BY(mutex_);
};

// Outlives the store once it was connected, since threads of the library may call a last time after
// all was closed. A program has a few.
struct NatsFleetStore::State {
  void Close() {
    if (connection) natsConnection_Close(connection.get());
    context.reset();
    connection.reset();
  }
  static void Keep(std::shared_ptr<State> state) {
    static Mutex kept_mutex;
    static auto& kept = *new std::vector<std::shared_ptr<State>>();
    MutexLock lock(kept_mutex);
    kept.push_back(std::move(state));
  }

  void NoteError(const std::string& text) {
    MutexLock lock(mutex);
    last_error = text;
    last_error_time = Clock::now();
  }
  // An error that the server sent while something waited for it.
  std::string RecentError() {
    constexpr milliseconds kSlack(200);
    MutexLock lock(mutex);
    return Clock::now() - last_error_time < kTimeout + kSlack ? last_error : "";
  }

  NatsHandle<natsConnection> connection;
  Mutex put_mutex;  // one batch after the other
  NatsAcknowledgements acknowledgements;
  NatsHandle<jsCtx> context;
  std::atomic<uint64_t> connections{0};
  Mutex mutex;
  std::string last_error ABSL_GUARDED_BY(mutex);
  Clock::time_point last_error_time ABSL_GUARDED_BY(mutex);
};

NatsFleetStore::NatsFleetStore(FleetAddress address)
    : address_(std::move(address)), state_(std::make_shared<State>()) {}

NatsFleetStore::~NatsFleetStore() { state_->Close(); }

uint64_t NatsFleetStore::connections() const { return state_->connections; }

std::string NatsFleetStore::SubjectOf(const std::string& key) const {
  return "$KV." + address_.Bucket() + "." + key;
}

absl::StatusOr<std::unique_ptr<NatsFleetStore>> NatsFleetStore::Connect(
    const FleetAddress& address) {
  SPLINEMAP_RETURN_IF_ERROR(CheckFleetAddress(address));
  std::unique_ptr<NatsFleetStore> store(new NatsFleetStore(address));
  State* const state = store->state_.get();
  natsOptions* made = nullptr;
  if (natsOptions_Create(&made) != NATS_OK) return Unavailable("NATS cannot be used");
  const NatsHandle<natsOptions> options(made);
  const std::vector<std::string> servers = absl::StrSplit(address.servers, ',');
  std::vector<const char*> urls;
  for (const std::string& server : servers) urls.push_back(server.c_str());
  natsOptions_SetServers(made, urls.data(), static_cast<int>(urls.size()));
  natsOptions_SetName(made, address.program.c_str());
  natsOptions_SetTimeout(made, kTimeout.count());
  natsOptions_SetMaxReconnect(made, -1);
  natsOptions_SetReconnectWait(made, 250);
  natsOptions_SetReconnectJitter(made, 250, 250);
  natsOptions_SetPingInterval(made, 2000);
  natsOptions_SetMaxPingsOut(made, 2);
  natsOptions_SetReconnectBufSize(made, 0);
  natsOptions_SetFailRequestsOnDisconnect(made, true);
  natsOptions_UseGlobalMessageDelivery(made, true);
  natsOptions_SetSendAsap(made, true);  // else it waits for a millisecond whether more comes
  natsOptions_SetReconnectedCB(
      made, [](natsConnection*, void* self) { ++static_cast<State*>(self)->connections; }, state);
  natsOptions_SetErrorHandler(
      made,
      [](natsConnection* connection, natsSubscription*, natsStatus error, void* self) {
        const char* text = nullptr;
        if (connection != nullptr) natsConnection_GetLastError(connection, &text);
        static_cast<State*>(self)->NoteError(
            text != nullptr && *text != '\0' ? text : natsStatus_GetText(error));
        if (error == NATS_NOT_PERMITTED) static_cast<State*>(self)->acknowledgements.Refuse();
        if (error == NATS_SLOW_CONSUMER) ++static_cast<State*>(self)->connections;
      },
      state);
  if (!address.credentials.empty()) {
    const std::string folder = address.credentials + "/";
    natsStatus tls = natsOptions_SetSecure(made, true);
    if (tls == NATS_OK) {
      tls = natsOptions_LoadCATrustedCertificates(made, (folder + "ca.pem").c_str());
    }
    if (tls == NATS_OK) {
      tls = natsOptions_LoadCertificatesChain(made, (folder + "own.pem").c_str(),
                                              (folder + "own.key").c_str());
    }
    if (tls != NATS_OK) {
      return absl::PermissionDeniedError(fmt::format("the credentials in {} cannot be used: {}",
                                                     address.credentials,
                                                     nats_GetLastError(nullptr)));
    }
    // Each server has the name under which it is called in its certificate.
    SPLINEMAP_ASSIGN_OR_RETURN(const std::string name, NameOfCredentials(address.credentials));
    if (NameOfToken(name).empty()) {
      return InvalidArgument(
          "{}own.pem was not made by deploy/fleet/credentials.sh: its name is '{}'", folder,
          PlainText(name));
    }
    // The inboxes that servers let this certificate have, and nobody else.
    natsOptions_SetCustomInboxPrefix(made, (kInboxes + name).c_str());
  }
  natsConnection* connection = nullptr;
  const natsStatus status = natsConnection_Connect(&connection, made);
  state->connection.reset(connection);
  if (!address.credentials.empty() && (status == NATS_PROTOCOL_ERROR || status == NATS_IO_ERROR)) {
    // They say no more, when they have read the certificate.
    return absl::PermissionDeniedError(fmt::format(
        "the servers at {} ended the connection: {}/own.pem is of another fleet, or has expired by "
        "their clocks, or they are being stopped",
        address.servers, address.credentials));
  }
  if (status != NATS_OK) return store->StatusOf(status, "the fleet");
  jsOptions js;
  jsOptions_Init(&js);
  js.Wait = kTimeout.count();
  js.PublishAsync.MaxPending = kMaxUnacknowledged;
  js.PublishAsync.StallWait = kTimeout.count();
  js.PublishAsync.AckHandler = [](jsCtx*, natsMsg* message, jsPubAck*, jsPubAckErr* error,
                                  void* self) {
    const NatsHandle<natsMsg> owned(message);
    static_cast<State*>(self)->acknowledgements.Handle(message, error);
  };
  js.PublishAsync.AckHandlerClosure = state;
  jsCtx* context = nullptr;
  if (natsConnection_JetStream(&context, connection, &js) != NATS_OK) {
    return Unavailable("JetStream cannot be used");
  }
  state->context.reset(context);
  State::Keep(store->state_);
  state->connections = 1;
  return store;
}

absl::Status NatsFleetStore::StatusOf(int code, const std::string& what) const {
  const auto status = static_cast<natsStatus>(code);
  if (status == NATS_OK) return absl::OkStatus();
  const char* const last = nats_GetLastError(nullptr);
  const std::string text = last != nullptr ? last : "";
  const std::string noted = state_->RecentError();
  if (absl::StrContains(noted, "ermissions Violation") &&
      (status == NATS_TIMEOUT || status == NATS_NOT_PERMITTED)) {
    return absl::PermissionDeniedError(fmt::format(
        "{}: the servers do not allow it ({}). Each robot may write its own layer alone, viewers "
        "nothing: are these the right credentials?",
        what, noted));
  }
  switch (status) {
    case NATS_CONNECTION_AUTH_FAILED:
    case NATS_CONNECTION_CLOSED:  // by the library, once they were refused twice
      return absl::PermissionDeniedError(Refused());
    case NATS_SECURE_CONNECTION_WANTED:
      return absl::PermissionDeniedError(
          fmt::format("the servers at {} do not use TLS, so nobody can tell whether they are the "
                      "fleet's; leave out --credentials for servers that take anybody",
                      address_.servers));
    case NATS_SECURE_CONNECTION_REQUIRED:
    case NATS_SSL_ERROR:
      if (address_.credentials.empty()) {
        return absl::PermissionDeniedError(fmt::format(
            "the servers at {} want credentials; give a folder of them with --credentials",
            address_.servers));
      }
      return absl::PermissionDeniedError(fmt::format(
          "the servers at {} are not of the fleet of {}/ca.pem, or their certificates have expired "
          "or name other hosts ({})",
          address_.servers, address_.credentials, text));
    case NATS_NO_SERVER:
      return Unavailable("no NATS server answers at {}; is nats-server running there?",
                         address_.servers);
    case NATS_NO_RESPONDERS:
      return Unavailable(
          "{}: nobody answers: the servers have no map '{}', which splinemap-fleet-worker makes "
          "when "
          "it starts, or no JetStream, or no leader at the moment",
          what, address_.map);
    case NATS_TIMEOUT:
      return Unavailable("{}: the servers did not answer in time", what);
    case NATS_CONNECTION_DISCONNECTED:
    case NATS_INSUFFICIENT_BUFFER:  // nothing is kept while it is lost
    case NATS_IO_ERROR:
    case NATS_STALE_CONNECTION:
      return Unavailable("{}: the connection to {} is lost; it is looked for again", what,
                         address_.servers);
    default:
      if (absl::StrContains(text, "stream not found")) {
        return NotFound(
            "the servers have no map '{}': splinemap-fleet-worker makes it when it starts",
            address_.map);
      }
  }
  return Unavailable("{}: {}", what, text.empty() ? natsStatus_GetText(status) : text);
}

std::string NatsFleetStore::Refused() const {
  return fmt::format(
      "the servers at {} do not know {}: deploy/fleet/credentials.sh adds and removes them, and "
      "the servers have to read users.conf again",
      address_.servers,
      address_.credentials.empty() ? "who connects without credentials"
                                   : "the credentials in " + address_.credentials);
}

absl::Status NatsFleetStore::MakeBucket(int replicas) {
  jsStreamConfig config;
  jsStreamConfig_Init(&config);
  const std::string name = address_.Stream();
  const std::string subject = SubjectOf(">");
  const char* subjects[] = {subject.c_str()};
  const std::string stored = fmt::format("splinemap.{}.stored.>", address_.map);
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
  natsStatus status = js_GetStreamInfo(&info, state_->context.get(), name.c_str(), nullptr, &error);
  if (status != NATS_OK) {
    status = js_AddStream(&info, state_->context.get(), &config, nullptr, &error);
  }
  jsStreamInfo_Destroy(info);
  return StatusOf(status, fmt::format("to make the map '{}'", address_.map));
}

absl::Status NatsFleetStore::Put(absl::Span<const FleetEntry> entries) {
  if (entries.empty()) return absl::OkStatus();
  MutexLock lock(state_->put_mutex);
  jsPubOptions options;
  jsPubOptions_Init(&options);
  options.MaxWait = kTimeout.count();
  natsStatus failed = NATS_OK;
  for (const FleetEntry& entry : entries) {
    SPLINEMAP_ASSIGN_OR_RETURN(NatsHandle<natsMsg> message, MessageOf(SubjectOf(entry.key), entry));
    natsMsg* raw = message.get();
    state_->acknowledgements.Await(raw);
    failed = js_PublishMsgAsync(state_->context.get(), &raw, &options);
    if (failed != NATS_OK) {
      state_->acknowledgements.GiveUp(message.get());
      break;
    }
    static_cast<void>(message.release());  // the acknowledgement frees it
  }
  const auto [status, text] = state_->acknowledgements.Wait();
  if (failed != NATS_OK) return StatusOf(failed, "to write");
  if (!text.empty() && status != NATS_TIMEOUT && status != NATS_NO_RESPONDERS) {
    return Unavailable("to write: {}", text);
  }
  return StatusOf(status, "to write");
}

absl::StatusOr<uint64_t> NatsFleetStore::PutIf(const FleetEntry& entry, uint64_t expected) {
  SPLINEMAP_ASSIGN_OR_RETURN(const NatsHandle<natsMsg> message,
                             MessageOf(SubjectOf(entry.key), entry));
  jsPubOptions options;
  jsPubOptions_Init(&options);
  options.MaxWait = kTimeout.count();
  options.ExpectLastSubjectSeq = expected;
  options.ExpectNoMessage = expected == 0;
  jsPubAck* ack = nullptr;
  jsErrCode error = static_cast<jsErrCode>(0);
  const natsStatus status =
      js_PublishMsg(&ack, state_->context.get(), message.get(), &options, &error);
  const NatsHandle<jsPubAck> owned(ack);
  if (error == JSStreamWrongLastSequenceErr) {
    return absl::AbortedError(fmt::format("{} was written by somebody else", entry.key));
  }
  if (status != NATS_OK) return StatusOf(status, "to write " + entry.key);
  return ack->Sequence;
}

absl::StatusOr<FleetEntry> NatsFleetStore::Get(const std::string& key_or_filter) {
  jsOptions options;
  jsOptions_Init(&options);
  options.Wait = kReadTimeout.count();
  natsMsg* message = nullptr;
  jsErrCode error = static_cast<jsErrCode>(0);
  const natsStatus status =
      js_GetLastMsg(&message, state_->context.get(), address_.Stream().c_str(),
                    SubjectOf(key_or_filter).c_str(), &options, &error);
  const NatsHandle<natsMsg> owned(message);
  if (error == JSNoMessageFoundErr || (status == NATS_NOT_FOUND && error != JSStreamNotFoundErr)) {
    return absl::OutOfRangeError(
        fmt::format("the map '{}' has no {}", address_.map, key_or_filter));
  }
  if (status != NATS_OK) return StatusOf(status, "to read " + key_or_filter);
  const std::string prefix = SubjectOf("");
  const std::string subject = natsMsg_GetSubject(message);
  if (!absl::StartsWith(subject, prefix)) return DataLoss("{} is of another bucket", subject);
  return EntryOf(message, subject.substr(prefix.size()), natsMsg_GetSequence(message));
}

absl::Status NatsFleetStore::List(const std::string& filter, bool with_values,
                                  absl::FunctionRef<void(FleetEntry entry)> visit) {
  // A consumer of its own that ends with the list. Acknowledged by nothing but flow control.
  const std::string what = "to list " + filter;
  const std::string prefix = SubjectOf("");
  jsSubOptions options;
  jsSubOptions_Init(&options);
  const std::string stream = address_.Stream();
  options.Stream = stream.c_str();
  options.Ordered = true;
  options.Config.DeliverPolicy = js_DeliverLastPerSubject;
  options.Config.HeadersOnly = !with_values;
  natsSubscription* made = nullptr;
  jsErrCode error = static_cast<jsErrCode>(0);
  natsStatus status = js_SubscribeSync(&made, state_->context.get(), SubjectOf(filter).c_str(),
                                       nullptr, &options, &error);
  if (status != NATS_OK) return StatusOf(status, what);
  const NatsHandle<natsSubscription> subscription(made);
  natsSubscription_SetPendingLimits(made, -1, -1);
  jsConsumerInfo* info = nullptr;
  status = natsSubscription_GetConsumerInfo(&info, made, nullptr, &error);
  if (status != NATS_OK) return StatusOf(status, what);
  uint64_t left = info->NumPending + info->Delivered.Consumer;
  jsConsumerInfo_Destroy(info);
  for (bool is_over = left == 0, has_ended = false; !is_over;) {
    natsMsg* raw = nullptr;
    status = natsSubscription_NextMsg(&raw, made, (has_ended ? kStraggle : kTimeout).count());
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
  return StatusOf(status, what);
}

absl::StatusOr<std::unique_ptr<FleetSubscription>> NatsFleetStore::Subscribe(
    const std::string& filter, Handler handler) {
  const std::string prefix = fmt::format("splinemap.{}.stored.", address_.map);
  auto subscription =
      std::make_unique<NatsSubscription>([prefix, handler = std::move(handler)](natsMsg* message) {
        const std::string subject = natsMsg_GetSubject(message);
        const uint64_t sequence = NumberOf(HeaderOf(message, "Nats-Sequence"), 10);
        if (!absl::StartsWith(subject, prefix) || sequence == 0) return;
        handler(EntryOf(message, subject.substr(prefix.size()), sequence));
      });
  const natsStatus status = subscription->Begin(state_->connection.get(), prefix + filter, "");
  if (status != NATS_OK) return StatusOf(status, "to follow " + filter);
  // So that what is stored after this comes.
  if (const natsStatus flushed =
          natsConnection_FlushTimeout(state_->connection.get(), kTimeout.count());
      flushed != NATS_OK) {
    return StatusOf(flushed, "to follow " + filter);
  }
  return subscription;
}

absl::StatusOr<std::string> NatsFleetStore::Request(const std::string& subject,
                                                    const std::string& request,
                                                    milliseconds deadline) {
  natsMsg* reply = nullptr;
  const natsStatus status = natsConnection_Request(
      &reply, state_->connection.get(), subject.c_str(), request.data(),
      static_cast<int>(request.size()), std::max<int64_t>(deadline.count(), 1));
  const NatsHandle<natsMsg> owned(reply);
  if (status == NATS_NO_RESPONDERS) {
    return Unavailable("no splinemap-fleet-worker answers for the map '{}'", address_.map);
  }
  if (status == NATS_TIMEOUT) {
    return absl::DeadlineExceededError("the fleet's workers did not answer in time");
  }
  if (status != NATS_OK) return StatusOf(status, "to ask");
  return ValueOf(reply);
}

absl::StatusOr<std::unique_ptr<FleetSubscription>> NatsFleetStore::Serve(const std::string& subject,
                                                                         const std::string& queue,
                                                                         Question question) {
  auto subscription =
      std::make_unique<NatsSubscription>([question = std::move(question)](natsMsg* message) {
        const char* const reply_to = natsMsg_GetReply(message);
        // Whoever asks chooses where the reply goes, and could have it stored.
        if (reply_to == nullptr || !absl::StartsWith(reply_to, kInboxes)) return;
        question(ValueOf(message), reply_to);
      });
  const natsStatus status = subscription->Begin(state_->connection.get(), subject, queue);
  if (status != NATS_OK) return StatusOf(status, "to answer " + subject);
  return subscription;
}

absl::Status NatsFleetStore::Tell(const std::string& subject, const std::string& message) {
  return StatusOf(natsConnection_Publish(state_->connection.get(), subject.c_str(), message.data(),
                                         static_cast<int>(message.size())),
                  "to tell " + subject);
}

absl::StatusOr<std::unique_ptr<FleetSubscription>> NatsFleetStore::Listen(
    const std::string& subject, std::function<void(const std::string& message)> handler) {
  auto subscription = std::make_unique<NatsSubscription>(
      [handler = std::move(handler)](natsMsg* message) { handler(ValueOf(message)); });
  const natsStatus status = subscription->Begin(state_->connection.get(), subject, "");
  if (status != NATS_OK) return StatusOf(status, "to listen to " + subject);
  return subscription;
}

bool NatsFleetStore::IsClosed() const {
  return natsConnection_Status(state_->connection.get()) == NATS_CONN_STATUS_CLOSED;
}

std::string NatsFleetStore::Problem() const {
  const natsConnStatus status = natsConnection_Status(state_->connection.get());
  if (status == NATS_CONN_STATUS_CONNECTED) return "";
  if (status == NATS_CONN_STATUS_CLOSED) return Refused();
  return fmt::format("the connection to the NATS servers at {} is lost; it is looked for again",
                     address_.servers);
}

}  // namespace splinemap
