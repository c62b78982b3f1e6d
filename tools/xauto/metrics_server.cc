// SPDX-License-Identifier: Apache-2.0
#include "xauto/metrics_server.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include "xauto/metrics.h"

namespace xauto::cli {
namespace {

std::string answer(const char* status, const std::string& type, const std::string& body,
                   bool with_body = true, const char* more = "") {
  return fmt::format(
      "HTTP/1.1 {}\r\nContent-Type: {}\r\nContent-Length: {}\r\nConnection: close\r\n{}\r\n{}",
      status, type, body.size(), more, with_body ? body : std::string());
}

std::string plain(const char* status, const char* text, const char* more = "") {
  return answer(status, "text/plain; charset=utf-8", text, true, more);
}

constexpr std::string_view kHeadEnd = "\r\n\r\n";

}  // namespace

std::string http_answer(std::string_view head, const std::string& metrics) {
  // RFC 9112 section 3: method SP target SP version CRLF. What the fields say changes nothing here.
  const std::string_view line = head.substr(0, head.find("\r\n"));
  const std::size_t first = line.find(' '), last = line.rfind(' ');
  if (first == std::string_view::npos || first == 0 || last <= first + 1 ||
      !line.substr(last + 1).starts_with("HTTP/1."))
    return plain("400 Bad Request", "this is no request of HTTP/1.1\n");
  const std::string_view method = line.substr(0, first);
  std::string_view target = line.substr(first + 1, last - first - 1);
  target = target.substr(0, target.find('?'));
  if (method != "GET" && method != "HEAD")
    return plain("405 Method Not Allowed", "only GET and HEAD\n", "Allow: GET, HEAD\r\n");
  if (target != "/metrics") return plain("404 Not Found", "the metrics are at /metrics\n");
  return answer("200 OK", kMetricsType, metrics, method == "GET");
}

Result<std::unique_ptr<MetricsServer>> MetricsServer::open(const std::string& address, int port) {
  const std::string where =
      "--metrics-address " + address + " --metrics-port " + std::to_string(port);
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV | AI_PASSIVE;
  addrinfo* found = nullptr;
  if (const int code = getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found);
      code != 0)
    return fail(ErrorCode::kInvalid, std::string("is no address: ") + gai_strerror(code), where,
                "127.0.0.1 for this machine alone, 0.0.0.0 or :: for everybody");
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> owned(found, freeaddrinfo);
  UniqueFd listener(::socket(found->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const int yes = 1;
  if (!listener || setsockopt(listener.get(), SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
      bind(listener.get(), found->ai_addr, found->ai_addrlen) != 0 ||
      listen(listener.get(), static_cast<int>(kMaxClients)) != 0)
    return fail(ErrorCode::kIo, std::string("cannot listen: ") + strerror(errno), where,
                errno == EADDRINUSE ? "another exporter has the port: choose another one" : "");
  sockaddr_storage bound{};
  socklen_t length = sizeof bound;
  if (getsockname(listener.get(), reinterpret_cast<sockaddr*>(&bound), &length) != 0)
    return fail(ErrorCode::kIo, std::string("has no address: ") + strerror(errno), where);
  const auto number = bound.ss_family == AF_INET6
                          ? reinterpret_cast<const sockaddr_in6*>(&bound)->sin6_port
                          : reinterpret_cast<const sockaddr_in*>(&bound)->sin_port;
  return std::unique_ptr<MetricsServer>(new MetricsServer(std::move(listener), ntohs(number)));
}

void MetricsServer::show(std::string metrics) {
  thread_.check();
  metrics_ = std::move(metrics);
}

void MetricsServer::add_to(std::vector<pollfd>& fds) const {
  thread_.check();
  fds.push_back({listener_.get(), POLLIN, 0});
  for (const Client& client : clients_) {
    const bool writes = client.sent < client.answer.size();
    fds.push_back({client.socket.get(), static_cast<short>(writes ? POLLOUT : POLLIN), 0});
  }
}

void MetricsServer::let_in(std::int64_t now_ns) {
  for (std::size_t i = 0; i < kMaxClients; ++i) {  // more of them next time
    UniqueFd socket(accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!socket) return;  // nobody more, or somebody who has hung up already
    if (clients_.size() == kMaxClients) clients_.erase(clients_.begin());
    clients_.push_back({std::move(socket), now_ns, {}, {}, 0});
  }
}

/// It has its answer, has hung up, or asks for more than there is.
bool MetricsServer::is_done(Client& client) const {
  while (client.answer.empty()) {
    char bytes[1024];
    const ssize_t got = recv(client.socket.get(), bytes, sizeof bytes, 0);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return false;
    if (got <= 0) return true;
    client.head.append(bytes, static_cast<std::size_t>(got));
    if (const std::size_t end = client.head.find(kHeadEnd); end != std::string::npos)
      client.answer =
          http_answer(std::string_view(client.head).substr(0, end + kHeadEnd.size()), metrics_);
    else if (client.head.size() > kMaxHeadBytes)
      client.answer = plain("431 Request Header Fields Too Large", "the request is too long\n");
  }
  while (client.sent < client.answer.size()) {
    const ssize_t sent = send(client.socket.get(), client.answer.data() + client.sent,
                              client.answer.size() - client.sent, MSG_NOSIGNAL);
    if (sent < 0) return errno != EAGAIN && errno != EINTR;
    client.sent += static_cast<std::size_t>(sent);
  }
  // What it may still send is read: closing over it would reset the connection, and the answer with it.
  shutdown(client.socket.get(), SHUT_WR);
  char rest[1024];
  const ssize_t got = recv(client.socket.get(), rest, sizeof rest, 0);
  return got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR);
}

void MetricsServer::serve(std::int64_t now_ns) {
  thread_.check();
  let_in(now_ns);
  std::erase_if(clients_, [&](Client& client) {
    return is_done(client) || now_ns - client.since_ns > kPatienceNs;
  });
}

}  // namespace xauto::cli
