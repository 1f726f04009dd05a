#include "services/viewer/server.h"

#include <unistd.h>

#include <array>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/generic/stream_protocol.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/local/connect_pair.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/asio/thread_pool.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/basic_stream.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <optional>
#include <utility>  // before Boost 1.74, which lacks it

#include "absl/strings/numbers.h"
#include "lib/base/status.h"
#include "services/viewer/into.h"
#include "services/viewer/page_file.h"

namespace splinemap {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using asio::awaitable;
using asio::ip::tcp;
using boost::system::error_code;
using Request = http::request<http::string_body>;
using Response = http::response<http::string_body>;
// Of TCP, or of the pair behind TLS: one kind of stream takes half as long to compile.
using Stream = beast::basic_stream<asio::generic::stream_protocol>;
using WebSocket = websocket::stream<Stream>;

constexpr std::chrono::seconds kRequestTimeout(10);  // for all of a request, and idle between two
constexpr std::chrono::seconds kResponseTimeout(60);
constexpr size_t kMaxHeaderBytes = 8 << 10;
constexpr size_t kMaxBodyBytes = 4 << 10;
constexpr size_t kMaxMessageBytes = 16 << 10;
constexpr size_t kWorkers = 2;

constexpr const char* kContentPolicy =
    "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'";

std::string_view ToStd(beast::string_view text) { return {text.data(), text.size()}; }

// A connection with TLS and, in the clear, the end of a pair whose other end is served.
struct TlsLink {
  asio::ssl::stream<tcp::socket> tls;
  asio::local::stream_protocol::socket clear;
  asio::steady_timer too_late;  // ends the handshake, and what nobody reads at the end

  void Close() {
    error_code ignored;
    too_late.cancel();
    tls.next_layer().close(ignored);
    clear.close(ignored);
  }
};

// Moves bytes until `from` or `to` ends.
template <typename From, typename To>
awaitable<void> Pump(From& from, To& to) {
  std::array<char, 16 << 10> bytes;
  error_code error;
  while (!error) {
    const size_t size = co_await from.async_read_some(asio::buffer(bytes), Into(error));
    if (!error) co_await asio::async_write(to, asio::buffer(bytes, size), Into(error));
  }
}

// What a client sends; it may end that and wait for the answer.
awaitable<void> PumpIn(std::shared_ptr<TlsLink> link) {
  co_await Pump(link->tls, link->clear);
  error_code ignored;
  link->clear.shutdown(asio::socket_base::shutdown_send, ignored);
}

awaitable<void> PumpOut(std::shared_ptr<TlsLink> link) {
  co_await Pump(link->clear, link->tls);
  link->Close();
}

const PageFile* FindPageFile(const std::string& path) {
  for (const PageFile& file : PageFiles()) {
    if (file.path == path) return &file;
  }
  return nullptr;
}

// The socket that whoever started the process left for it: sd_listen_fds(3).
std::optional<int> InheritedSocket() {
  constexpr int kFirst = 3;
  const char* pid = std::getenv("LISTEN_PID");
  const char* count = std::getenv("LISTEN_FDS");
  int number = 0;
  const bool is_ours = pid != nullptr && count != nullptr && absl::SimpleAtoi(pid, &number) &&
                       number == getpid() && std::string_view(count) == "1";
  return is_ours ? std::optional(kFirst) : std::nullopt;
}

absl::StatusOr<tcp::acceptor> OpenAcceptor(asio::io_context& io, const ServerOptions& options) {
  tcp::acceptor acceptor(io);
  error_code error;
  if (const std::optional<int> socket = InheritedSocket()) {
    acceptor.assign(tcp::v4(), *socket, error);
    if (!error) acceptor.local_endpoint(error);
    if (error) return Unavailable("the socket of LISTEN_FDS is of no use: {}", error.message());
    return acceptor;
  }
  const asio::ip::address address = asio::ip::make_address(options.address, error);
  if (error) {
    return InvalidArgument("{} is no address; 0.0.0.0 is every address of this computer",
                           options.address);
  }
  const tcp::endpoint endpoint(address, options.port);
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(tcp::acceptor::max_listen_connections, error);
  if (error) {
    return Unavailable("cannot listen on {} port {}: {}; choose another with --port",
                       options.address, options.port, error.message());
  }
  return acceptor;
}

absl::Status LoadCertificate(const ServerOptions& options, asio::ssl::context& tls) {
  error_code error;
  tls.set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_tlsv1 |
                  asio::ssl::context::no_tlsv1_1);
  tls.use_certificate_chain_file(options.certificate_path, error);
  if (error)
    return InvalidArgument("{} is no certificate: {}", options.certificate_path, error.message());
  tls.use_private_key_file(options.key_path, asio::ssl::context::pem, error);
  if (error) {
    return InvalidArgument("{} is no key of the certificate: {}", options.key_path,
                           error.message());
  }
  return absl::OkStatus();
}

class BeastServer : public Server {
 public:
  BeastServer(asio::io_context& io, tcp::acceptor acceptor, asio::ssl::context tls,
              const ServerOptions& options, Viewer& viewer)
      : io_(io),
        acceptor_(std::move(acceptor)),
        tls_(std::move(tls)),
        options_(options),
        viewer_(viewer) {
    access_.is_loopback = acceptor_.local_endpoint().address().is_loopback();
    access_.token = options.token;
    asio::co_spawn(io_, Accept(), asio::detached);
  }

  // Before what its workers use is gone.
  ~BeastServer() override {
    workers_.stop();
    workers_.join();
  }

  std::string url() const override {
    const tcp::endpoint endpoint = acceptor_.local_endpoint();
    const std::string host =
        endpoint.address().is_unspecified() ? "HOSTNAME" : endpoint.address().to_string();
    return fmt::format("{}://{}:{}/{}", IsSecure() ? "https" : "http",
                       endpoint.address().is_v6() ? "[" + host + "]" : host, endpoint.port(),
                       options_.token.empty() ? "" : "?token=" + options_.token);
  }

 private:
  long CountConnections() const { return connections_.use_count() - 1; }
  void ReportConnections() {
    viewer_.metrics().connections.Set(static_cast<double>(CountConnections()));
  }
  bool IsSecure() const { return !options_.certificate_path.empty(); }

  awaitable<void> Accept() {
    while (true) {
      error_code error;
      tcp::socket socket = co_await acceptor_.async_accept(Into(error));
      if (error) {  // out of file descriptors, say
        asio::steady_timer pause(io_, std::chrono::milliseconds(100));
        co_await pause.async_wait(Into(error));
        continue;
      }
      if (CountConnections() >= kMaxConnections) {
        viewer_.metrics().refused.Increment();
        continue;  // closes it
      }
      try {
        asio::co_spawn(io_, Serve(std::move(socket)), asio::detached);
      } catch (const std::exception&) {  // the memory is full
        viewer_.metrics().refused.Increment();
      }
    }
  }

  awaitable<void> Serve(tcp::socket socket) {
    std::shared_ptr<void> counted = connections_;
    ReportConnections();
    error_code error;
    socket.set_option(tcp::no_delay(true), error);
    if (IsSecure()) {
      co_await ServeTls(std::move(socket));
    } else {
      Stream stream{asio::generic::stream_protocol::socket(std::move(socket))};
      co_await ServeRequests(stream);
    }
    counted.reset();
    // Not as a destructor: connections that the end of the program cuts off outlive this.
    ReportConnections();
  }

  awaitable<void> ServeTls(tcp::socket socket) {
    using Local = asio::local::stream_protocol;
    const auto link = std::make_shared<TlsLink>(
        TlsLink{{std::move(socket), tls_}, Local::socket(io_), asio::steady_timer(io_)});
    const auto close_in_time = [link] {
      link->too_late.expires_after(kRequestTimeout);
      link->too_late.async_wait([link](const error_code& cancelled) {
        if (!cancelled) link->Close();
      });
    };
    close_in_time();
    error_code error;
    co_await link->tls.async_handshake(asio::ssl::stream_base::server, Into(error));
    link->too_late.cancel();
    if (error) co_return;
    Local::socket served(io_);
    asio::local::connect_pair(link->clear, served, error);
    if (error) co_return;
    asio::co_spawn(io_, PumpIn(link), asio::detached);
    asio::co_spawn(io_, PumpOut(link), asio::detached);
    {
      Stream stream{asio::generic::stream_protocol::socket(std::move(served))};
      co_await ServeRequests(stream);
    }
    if (link->clear.is_open()) close_in_time();
  }

  awaitable<void> ServeRequests(Stream& stream) {
    beast::flat_buffer buffer(kMaxHeaderBytes + kMaxBodyBytes);
    for (bool goes_on = true; goes_on;) {
      http::request_parser<http::string_body> parser;
      parser.header_limit(kMaxHeaderBytes);
      parser.body_limit(kMaxBodyBytes);
      stream.expires_after(kRequestTimeout);
      error_code error;
      co_await http::async_read(stream, buffer, parser, Into(error));
      if (error == http::error::end_of_stream || error == beast::error::timeout) co_return;
      if (error && error.category() != http::make_error_code(http::error::bad_method).category())
        co_return;
      viewer_.metrics().requests.Increment();
      Request request = parser.release();
      if (!error && websocket::is_upgrade(request) &&
          ToStd(request.target()).substr(0, request.target().find('?')) == "/live") {
        if (const absl::Status allowed = CheckAccess(request); allowed.ok()) {
          co_await ServeBrowser(stream, request);
          co_return;
        }
      }
      HttpAnswer answer;
      if (error) {
        answer = ErrorAnswer(InvalidArgument("this is no request: {}", error.message()));
      } else {
        answer = co_await Answer(request);
      }
      if (answer.status >= 400) viewer_.metrics().refused.Increment();
      Response response = ResponseOf(std::move(answer));
      response.keep_alive(!error && request.keep_alive());
      goes_on = response.keep_alive();
      stream.expires_after(kResponseTimeout);
      co_await http::async_write(stream, response, Into(error));
      if (error) co_return;
    }
    error_code ignored;
    stream.socket().shutdown(asio::socket_base::shutdown_send, ignored);
  }

  absl::Status CheckAccess(const Request& request) const {
    const absl::StatusOr<HttpTarget> target = HttpTarget::Parse(ToStd(request.target()));
    if (!target.ok()) return target.status();
    const auto token = target->parameters.find("token");
    return access_.Check({.host = ToStd(request[http::field::host]),
                          .origin = ToStd(request[http::field::origin]),
                          .authorization = ToStd(request[http::field::authorization]),
                          .fetch_site = ToStd(request["Sec-Fetch-Site"]),
                          .token = token == target->parameters.end() ? "" : token->second});
  }

  awaitable<HttpAnswer> Answer(const Request& request) {
    const absl::StatusOr<HttpTarget> target = HttpTarget::Parse(ToStd(request.target()));
    if (!target.ok()) co_return ErrorAnswer(target.status());
    const bool is_get = request.method() == http::verb::get;
    if (is_get && target->path == "/healthz")
      co_return HttpAnswer{.content_type = "text/plain", .body = "ok\n"};
    if (const PageFile* file = FindPageFile(target->path); is_get && file != nullptr) {
      co_return HttpAnswer{.content_type = std::string(file->content_type),
                           .body = std::string(file->content)};
    }
    if (const absl::Status allowed = CheckAccess(request); !allowed.ok())
      co_return ErrorAnswer(allowed);
    if (is_get) co_return co_await OnWorkers([&] { return viewer_.Get(*target); });
    if (request.method() != http::verb::post)
      co_return ErrorAnswer(InvalidArgument("only GET and POST are answered"));
    // A form of another site cannot send this without asking first.
    if (ToStd(request[http::field::content_type]) != "application/json")
      co_return ErrorAnswer(InvalidArgument("the Content-Type is to be application/json"));
    co_return co_await OnWorkers([&] { return viewer_.Post(*target, request.body()); });
  }

  // What `make` returns, made in another thread.
  template <typename Make>
  awaitable<HttpAnswer> OnWorkers(Make make) {
    HttpAnswer answer;
    asio::steady_timer done(io_, asio::steady_timer::time_point::max());
    asio::post(workers_, [&] {
      try {
        answer = make();
      } catch (const std::exception& error) {
        answer = ErrorAnswer(Unavailable("no answer: {}", error.what()));
      }
      asio::post(io_, [&] { done.cancel(); });
    });
    error_code ignored;
    co_await done.async_wait(Into(ignored));
    co_return answer;
  }

  static Response ResponseOf(HttpAnswer answer) {
    Response response(http::int_to_status(static_cast<unsigned>(answer.status)), 11);
    response.set(http::field::content_type, answer.content_type);
    response.set(http::field::cache_control, "no-store");
    response.set("Content-Security-Policy", kContentPolicy);
    response.set("X-Content-Type-Options", "nosniff");
    response.set("Referrer-Policy", "no-referrer");
    response.set("Cross-Origin-Resource-Policy", "same-origin");
    if (answer.status == 401) response.set(http::field::www_authenticate, "Bearer");
    response.body() = std::move(answer.body);
    response.prepare_payload();
    return response;
  }

  awaitable<void> ServeBrowser(Stream& stream, const Request& request) {
    // The WebSocket has timeouts of its own.
    stream.expires_never();
    auto socket = std::make_shared<WebSocket>(std::move(stream));
    socket->set_option(websocket::stream_base::timeout::suggested(beast::role_type::server));
    socket->read_message_max(kMaxMessageBytes);
    socket->binary(true);
    error_code error;
    co_await socket->async_accept(request, Into(error));
    if (error) co_return;
    const std::shared_ptr<Viewer::Browser> browser = viewer_.Join();
    if (browser == nullptr) {
      viewer_.metrics().refused.Increment();
      co_await socket->async_close({websocket::close_code::try_again_later, "too many pages"},
                                   Into(error));
      co_return;
    }
    asio::co_spawn(io_, SendFrames(socket, browser), asio::detached);
    bool is_refused = false;
    try {
      is_refused = co_await ReadMessages(*socket, *browser);
    } catch (const std::exception&) {  // the memory is full
    }
    viewer_.Leave(browser);
    if (is_refused) {
      co_await socket->async_close({websocket::close_code::policy_error, "no such message"},
                                   Into(error));
    }
  }

  // Until the page ends; true where it says what no page says.
  awaitable<bool> ReadMessages(WebSocket& socket, Viewer::Browser& browser) {
    beast::flat_buffer buffer;
    while (true) {
      error_code error;
      co_await socket.async_read(buffer, Into(error));
      if (error) co_return false;
      const auto bytes = buffer.data();
      const absl::Status handled =
          viewer_.Handle(browser, {static_cast<const char*>(bytes.data()), bytes.size()});
      buffer.consume(bytes.size());
      if (!handled.ok()) co_return true;
    }
  }

  awaitable<void> SendFrames(std::shared_ptr<WebSocket> socket,
                             std::shared_ptr<Viewer::Browser> browser) {
    try {
      co_await SendUntilGone(*socket, *browser);
    } catch (const std::exception&) {  // the memory is full: the page connects again
      beast::get_lowest_layer(*socket).close();
    }
  }

  awaitable<void> SendUntilGone(WebSocket& socket, Viewer::Browser& browser) {
    error_code error;
    while (!browser.is_gone && !error) {
      const std::optional<std::string> frame = viewer_.NextFrame(browser);
      if (frame) {
        co_await socket.async_write(asio::buffer(*frame), Into(error));
      } else {
        browser.wake.expires_at(asio::steady_timer::time_point::max());
        error_code cancelled;
        co_await browser.wake.async_wait(Into(cancelled));
      }
    }
  }

  asio::io_context& io_;
  tcp::acceptor acceptor_;
  asio::ssl::context tls_;
  const ServerOptions options_;
  Viewer& viewer_;
  Access access_;
  // Held by every connection, even by one that ends with an exception.
  const std::shared_ptr<void> connections_ = std::make_shared<int>();
  asio::thread_pool workers_{kWorkers};
};

}  // namespace

absl::StatusOr<std::unique_ptr<Server>> Server::Listen(asio::io_context& io,
                                                       const ServerOptions& options,
                                                       Viewer& viewer) {
  if (options.certificate_path.empty() != options.key_path.empty())
    return InvalidArgument("TLS needs both, --certificate and --key");
  SPLINEMAP_ASSIGN_OR_RETURN(tcp::acceptor acceptor, OpenAcceptor(io, options));
  if (!acceptor.local_endpoint().address().is_loopback()) {
    if (options.token.empty()) {
      return InvalidArgument(
          "{} can be reached from other computers: give a file with a token, --token-file",
          acceptor.local_endpoint().address().to_string());
    }
    if (options.certificate_path.empty()) {
      return InvalidArgument(
          "{} can be reached from other computers: give a certificate, --certificate and --key, so "
          "that nobody on the way reads the token",
          acceptor.local_endpoint().address().to_string());
    }
  }
  asio::ssl::context tls(asio::ssl::context::tls_server);
  if (!options.certificate_path.empty()) SPLINEMAP_RETURN_IF_ERROR(LoadCertificate(options, tls));
  return std::make_unique<BeastServer>(io, std::move(acceptor), std::move(tls), options, viewer);
}

}  // namespace splinemap
