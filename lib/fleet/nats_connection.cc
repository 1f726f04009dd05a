#include "lib/fleet/nats_connection.h"

#include "absl/strings/match.h"
#include "absl/strings/str_split.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/nats_subscription.h"

namespace splinemap {
namespace {

constexpr int64_t kMaxUnacknowledged = 256;  // of messages

}  // namespace

absl::StatusOr<NatsConnection*> NatsConnection::Connect(const FleetAddress& address) {
  SPLINEMAP_RETURN_IF_ERROR(CheckFleetAddress(address));
  std::unique_ptr<NatsConnection> made(new NatsConnection(address));
  SPLINEMAP_RETURN_IF_ERROR(made->Open());
  static Mutex all_mutex;
  static auto& all = *new std::vector<std::unique_ptr<NatsConnection>>();
  MutexLock lock(all_mutex);
  all.push_back(std::move(made));
  return all.back().get();
}

absl::Status NatsConnection::Open() {
  natsOptions* made = nullptr;
  if (natsOptions_Create(&made) != NATS_OK) return Unavailable("NATS cannot be used");
  const NatsHandle<natsOptions> options(made);
  const std::vector<std::string> servers = absl::StrSplit(address_.servers, ',');
  std::vector<const char*> urls;
  for (const std::string& server : servers) urls.push_back(server.c_str());
  natsOptions_SetServers(made, urls.data(), static_cast<int>(urls.size()));
  natsOptions_SetName(made, address_.program.c_str());
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
      made, [](natsConnection*, void* self) { ++static_cast<NatsConnection*>(self)->connections_; },
      this);
  natsOptions_SetErrorHandler(
      made,
      [](natsConnection* connection, natsSubscription*, natsStatus error, void* self) {
        const char* text = nullptr;
        if (connection != nullptr) natsConnection_GetLastError(connection, &text);
        static_cast<NatsConnection*>(self)->HandleError(
            error, text != nullptr && *text != '\0' ? text : natsStatus_GetText(error));
      },
      this);
  if (!address_.credentials.empty()) SPLINEMAP_RETURN_IF_ERROR(UseCredentials(made));

  const Clock::time_point begin = Clock::now();
  natsConnection* connection = nullptr;
  const natsStatus status = natsConnection_Connect(&connection, made);
  connection_.reset(connection);
  if (!address_.credentials.empty() && (status == NATS_PROTOCOL_ERROR || status == NATS_IO_ERROR)) {
    // They say no more, when they have read the certificate.
    return absl::PermissionDeniedError(fmt::format(
        "the servers at {} ended the connection: {}/own.pem is of another fleet, or has expired by "
        "their clocks, or they are being stopped",
        address_.servers, address_.credentials));
  }
  if (status != NATS_OK) return StatusOf(status, "the fleet", begin);
  jsOptions js;
  jsOptions_Init(&js);
  js.Wait = kTimeout.count();
  js.PublishAsync.MaxPending = kMaxUnacknowledged;
  js.PublishAsync.StallWait = kTimeout.count();
  js.PublishAsync.AckHandler = [](jsCtx*, natsMsg* message, jsPubAck* ack, jsPubAckErr* error,
                                  void* self) {
    const NatsHandle<natsMsg> owned(message);
    static_cast<NatsConnection*>(self)->acknowledgements_.Handle(message, ack, error);
  };
  js.PublishAsync.AckHandlerClosure = this;
  jsCtx* context = nullptr;
  if (natsConnection_JetStream(&context, connection, &js) != NATS_OK) {
    return Unavailable("JetStream cannot be used");
  }
  context_.reset(context);
  ++connections_;
  return absl::OkStatus();
}

absl::Status NatsConnection::UseCredentials(natsOptions* options) const {
  const std::string folder = address_.credentials + "/";
  natsStatus status = natsOptions_SetSecure(options, true);
  if (status == NATS_OK) {
    status = natsOptions_LoadCATrustedCertificates(options, (folder + "ca.pem").c_str());
  }
  if (status == NATS_OK) {
    status = natsOptions_LoadCertificatesChain(options, (folder + "own.pem").c_str(),
                                               (folder + "own.key").c_str());
  }
  if (status != NATS_OK) {
    return absl::PermissionDeniedError(fmt::format("the credentials in {} cannot be used: {}",
                                                   address_.credentials,
                                                   nats_GetLastError(nullptr)));
  }
  // Each server has the name under which it is called in its certificate.
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string name, NameOfCredentials(address_.credentials));
  if (NameOfToken(name).empty()) {
    return InvalidArgument(
        "{}own.pem was not made by deploy/fleet/credentials.sh: its name is '{}'", folder,
        PlainText(name));
  }
  // The inboxes that servers let this certificate have, and nobody else.
  natsOptions_SetCustomInboxPrefix(options, (NatsSubscription::kInboxes + name).c_str());
  return absl::OkStatus();
}

void NatsConnection::Close() {
  if (connection_) natsConnection_Close(connection_.get());
  context_.reset();
  connection_.reset();
}

NatsAcknowledgements::Outcome NatsConnection::Write(std::vector<NatsHandle<natsMsg>> messages,
                                                    jsPubOptions options) {
  MutexLock lock(write_mutex_);
  options.MaxWait = kTimeout.count();
  natsStatus failed = NATS_OK;
  for (NatsHandle<natsMsg>& message : messages) {
    if (!message) {
      failed = NATS_NO_MEMORY;
      break;
    }
    natsMsg* raw = message.get();
    acknowledgements_.Await(raw);
    failed = js_PublishMsgAsync(context_.get(), &raw, &options);
    if (failed != NATS_OK) {
      acknowledgements_.GiveUp(message.get());
      break;
    }
    static_cast<void>(message.release());  // the acknowledgement frees it
  }
  NatsAcknowledgements::Outcome outcome = acknowledgements_.Wait();
  if (failed != NATS_OK) {
    outcome.status = failed;
    outcome.text.clear();
  }
  return outcome;
}

void NatsConnection::HandleError(natsStatus error, const char* text) {
  {
    MutexLock lock(mutex_);
    last_error_ = text;
    last_error_time_ = Clock::now();
  }
  if (error == NATS_NOT_PERMITTED && absl::StrContains(text, "for Publish to \"$KV.")) {
    acknowledgements_.Refuse();
  }
  if (error == NATS_SLOW_CONSUMER) ++connections_;
}

std::string NatsConnection::LastErrorSince(Clock::time_point begin) const {
  MutexLock lock(mutex_);
  return last_error_time_ >= begin ? last_error_ : "";
}

absl::Status NatsConnection::StatusOf(natsStatus status, const std::string& what,
                                      Clock::time_point begin) const {
  if (status == NATS_OK) return absl::OkStatus();
  const char* const last = nats_GetLastError(nullptr);
  const std::string text = last != nullptr ? last : "";
  const std::string noted = LastErrorSince(begin);
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
          "when it starts, or no JetStream, or no leader at the moment",
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

absl::Status NatsConnection::StatusOf(const NatsAcknowledgements::Outcome& outcome,
                                      const std::string& what, Clock::time_point begin) const {
  if (!outcome.text.empty() && outcome.status != NATS_TIMEOUT &&
      outcome.status != NATS_NO_RESPONDERS) {
    return Unavailable("{}: {}", what, outcome.text);
  }
  return StatusOf(outcome.status, what, begin);
}

std::string NatsConnection::Refused() const {
  return fmt::format(
      "the servers at {} do not know {}: deploy/fleet/credentials.sh adds and removes them, and "
      "the servers have to read users.conf again",
      address_.servers,
      address_.credentials.empty() ? "who connects without credentials"
                                   : "the credentials in " + address_.credentials);
}

bool NatsConnection::IsClosed() const {
  return natsConnection_Status(connection_.get()) == NATS_CONN_STATUS_CLOSED;
}

std::string NatsConnection::Problem() const {
  const natsConnStatus status = natsConnection_Status(connection_.get());
  if (status == NATS_CONN_STATUS_CONNECTED) return "";
  if (status == NATS_CONN_STATUS_CLOSED) return Refused();
  return fmt::format("the connection to the NATS servers at {} is lost; it is looked for again",
                     address_.servers);
}

}  // namespace splinemap
