// SPDX-License-Identifier: Apache-2.0
#include "launch/meeting.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/socket.h"
#include "base/thread.h"

namespace xauto::launch {
namespace {

constexpr std::size_t kMostLines = 64;
constexpr int kMeetingLookMs = 100, kMeetingConnectMs = 1000, kSendMs = 2000;
constexpr std::int64_t kSeekNs = 500'000'000, kThanksNs = 5'000'000'000;

struct Resolved {
  addrinfo* list = nullptr;
  ~Resolved() {
    if (list != nullptr) freeaddrinfo(list);
  }
};

Status resolve(const std::string& address, bool to_listen, Resolved& into) {
  const std::size_t colon = address.rfind(':');
  if (colon == std::string::npos || colon == 0 || colon + 1 == address.size())
    return fail(ErrorCode::kInvalid, "'" + address + "' is not ADDRESS:PORT", "--meet",
                "the first host's address, the same for all parts: --meet 10.0.0.1:7400");
  std::string host = address.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']')
    host = host.substr(1, host.size() - 2);
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV | (to_listen ? AI_PASSIVE : 0);
  const int code = getaddrinfo(host.c_str(), address.substr(colon + 1).c_str(), &hints, &into.list);
  if (code == 0) return {};
  return fail(ErrorCode::kInvalid, "'" + address + "': " + gai_strerror(code), "--meet",
              "the first host's address, the same for all parts: --meet 10.0.0.1:7400");
}

Result<UniqueFd> listen_at(const std::string& address) {
  Resolved found;
  XAUTO_TRY(resolve(address, true, found));
  int why = 0;
  for (const addrinfo* at = found.list; at != nullptr; at = at->ai_next) {
    UniqueFd socket(::socket(at->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    const int one = 1;
    if (socket) (void)setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (socket && bind(socket.get(), at->ai_addr, at->ai_addrlen) == 0 &&
        listen(socket.get(), 16) == 0)
      return socket;
    why = errno;
  }
  return fail(ErrorCode::kUnavailable, "cannot listen at " + address + ": " + strerror(why),
              "--meet",
              "the platform's first host listens there: give an address of that computer");
}

/// Within a second; none: nobody is there.
UniqueFd connect_to(const std::string& address) {
  Resolved found;
  if (!resolve(address, false, found)) return {};
  for (const addrinfo* at = found.list; at != nullptr; at = at->ai_next) {
    UniqueFd socket(::socket(at->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    if (!socket) continue;
    if (connect(socket.get(), at->ai_addr, at->ai_addrlen) == 0) return socket;
    if (errno != EINPROGRESS) continue;
    pollfd ready{socket.get(), POLLOUT, 0};
    int error = 0;
    socklen_t size = sizeof error;
    if (poll(&ready, 1, kMeetingConnectMs) == 1 &&
        getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &error, &size) == 0 && error == 0)
      return socket;
  }
  return {};
}

/// All of it, or within two seconds of silence nothing more.
bool send_all(int socket, const std::vector<std::byte>& frame) {
  for (std::size_t sent = 0; sent < frame.size();) {
    const ssize_t count = send(socket, frame.data() + sent, frame.size() - sent, MSG_NOSIGNAL);
    if (count > 0) {
      sent += static_cast<std::size_t>(count);
      continue;
    }
    if (count < 0 && errno == EINTR) continue;
    pollfd ready{socket, POLLOUT, 0};
    if (count >= 0 || errno != EAGAIN || poll(&ready, 1, kSendMs) != 1) return false;
  }
  return true;
}

void send_at_once(int socket) {
  const int one = 1;
  (void)setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
}

/// What has come. False: the other end has gone.
bool receive(int socket, FrameReader& into) {
  std::array<std::byte, 16 << 10> bytes;
  const ssize_t count = recv(socket, bytes.data(), bytes.size(), MSG_DONTWAIT);
  if (count > 0) into.feed(std::span(bytes).first(static_cast<std::size_t>(count)));
  return count > 0 || (count < 0 && (errno == EAGAIN || errno == EINTR));
}

}  // namespace

Meeting::Meeting(MeetingRequest request)
    : request_(std::move(request)),
      leads_(request_.set_up.own.host == request_.set_up.hosts.front()),
      table_(request_.set_up, {now_ns(), now_ns() + tai_offset_ns()}) {}

MeetingTable::Instant Meeting::now() const {
  const std::int64_t now = now_ns();
  return {now, clock_ns(CLOCK_TAI)};
}

Status Meeting::open() {
  wake_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (leads_) {
    XAUTO_ASSIGN(listener_, listen_at(request_.address));
  } else {
    Resolved found;
    XAUTO_TRY(resolve(request_.address, false, found));
  }
  XAUTO_ASSIGN(thread_, start_thread([this] { serve(); }));
  return {};
}

Result<std::unique_ptr<Meeting>> Meeting::begin(MeetingRequest request) {
  auto meeting = std::unique_ptr<Meeting>(new Meeting(std::move(request)));
  XAUTO_TRY(meeting->open());
  const std::int64_t limit = now_ns() + meeting->request_.set_up.limit_ns;
  const std::atomic<bool>* stop = meeting->request_.stop;
  while (meeting->run() == 0) {
    if (auto error = meeting->error()) return tl::unexpected(*std::move(error));
    if (stop != nullptr && stop->load())
      return fail(ErrorCode::kUnavailable, "was told to stop before all parts were there",
                  "--meet");
    if (!meeting->leads_ && now_ns() > limit)
      return fail(ErrorCode::kTimeout,
                  fmt::format("the parts did not come together at {} within {:g} s",
                              meeting->request_.address,
                              static_cast<double>(meeting->request_.set_up.limit_ns) * 1e-9),
                  "--meet",
                  "start the part of the platform's first host, '" +
                      meeting->request_.set_up.hosts.front() +
                      "': it listens there, and says who is missing");
    sleep_until_ns(now_ns() + 10'000'000);
  }
  return meeting;
}

Meeting::~Meeting() {
  quit_.store(true);
  signal_eventfd(wake_.get());
  if (thread_.joinable()) thread_.join();
}

std::uint64_t Meeting::run() const {
  const Guard lock(mutex_);
  return run_;
}

std::int64_t Meeting::clock_offset_ns() const {
  const Guard lock(mutex_);
  return start_tai_ns_ - start_ns_;
}

std::int64_t Meeting::start_ns() const {
  const Guard lock(mutex_);
  return start_ns_;
}
std::optional<Error> Meeting::error() const {
  const Guard lock(mutex_);
  return error_;
}

void Meeting::reached(PartStage stage) {
  const Guard lock(mutex_);
  if (stage <= stage_) return;
  stage_ = stage;
  if (leads_)
    carry_out(table_.own(stage, now()));
  else
    tell_stage();
}

// ---- the thread --------------------------------------------------------------------------------

void Meeting::serve() {
  while (!quit_.load()) {
    std::vector<pollfd> fds = {{wake_.get(), POLLIN, 0}};
    if (clock_.fd() >= 0) fds.push_back({clock_.fd(), POLLIN, 0});
    if (listener_) fds.push_back({listener_.get(), POLLIN, 0});
    {
      const Guard lock(mutex_);
      for (const auto& [connection, line] : lines_) fds.push_back({line.socket.get(), POLLIN, 0});
      if (line_) fds.push_back({line_->socket.get(), POLLIN, 0});
    }
    (void)poll(fds.data(), fds.size(), kMeetingLookMs);
    drain_eventfd(wake_.get());
    UniqueFd fresh;  // found without the lock: it may take a second
    if (!leads_) {
      bool wants = false;
      {
        const Guard lock(mutex_);
        wants = wants_line();
      }
      if (wants) fresh = connect_to(request_.address);
    }
    const Guard lock(mutex_);
    look_at_clock();
    if (!leads_) {
      seek(std::move(fresh));
      continue;
    }
    accept();
    std::vector<int> ready;
    for (const pollfd& fd : fds)
      if (fd.revents != 0 && lines_.contains(fd.fd)) ready.push_back(fd.fd);
    for (const int connection : ready) hear(connection);
    carry_out(table_.tick(now()));
  }
}

void Meeting::look_at_clock() {
  const auto step_ns = clock_.step_ns();
  if (!step_ns) return;
  ++steps_;
  if (std::abs(*step_ns) > std::abs(longest_step_ns_)) longest_step_ns_ = *step_ns;
  log::warn("the clock of '{}' was set by {:.6f} s: what is claimed across hosts does not stand",
            request_.set_up.own.host, static_cast<double>(*step_ns) * 1e-9);
}

void Meeting::start_at(std::int64_t tai_ns) {
  if (tai_ns <= 0 || start_tai_ns_ != 0) return;
  start_tai_ns_ = tai_ns;
  start_ns_ = tai_ns - tai_offset_ns();
}

// ---- the first host's --------------------------------------------------------------------------

void Meeting::accept() {
  for (;;) {
    UniqueFd socket(accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!socket) return;
    if (lines_.size() >= kMostLines) continue;
    send_at_once(socket.get());
    const int connection = socket.get();
    lines_[connection].socket = std::move(socket);
    carry_out(table_.connected(connection, now()));
  }
}

void Meeting::hear(int connection) {
  bool there = receive(connection, lines_[connection].frames);
  while (lines_.contains(connection)) {
    FrameReader& frames = lines_[connection].frames;
    const auto message = frames.next(table_.known(connection) ? kMostReportBytes : kMostFrameBytes);
    there = there && !frames.bad();
    if (!message) break;
    carry_out(table_.hear(connection, *message, now()));
  }
  if (there || !lines_.contains(connection)) return;
  carry_out(table_.gone(connection, now()));
  lines_.erase(connection);
}

void Meeting::carry_out(MeetingTable::Says says) {
  for (std::size_t i = 0; i < says.size(); ++i) {
    const MeetingTable::Say say = says[i];
    const auto line = lines_.find(say.to);
    if (line == lines_.end()) continue;
    const bool sent = send_all(line->second.socket.get(), frame_of(say.what));
    if (sent && !say.close) continue;
    lines_.erase(line);
    for (MeetingTable::Say& more : table_.gone(say.to, now())) says.push_back(std::move(more));
  }
  for (const std::string& text : table_.take_news()) log::warn("{}", text);
  run_ = table_.run();
  start_at(table_.start_tai_ns());
  if (table_.error() && !error_) error_ = table_.error();
}

// ---- the others' -------------------------------------------------------------------------------

void Meeting::tell(const Json& message) {
  if (line_ && !send_all(line_->socket.get(), frame_of(message))) lose();
}

void Meeting::tell_stage() {
  if (!welcome_) return;
  if (stage_ == PartStage::kReported)
    tell({{"is", "report"}, {"text", report_}});
  else if (stage_ >= PartStage::kBuilt)
    tell({{"is", "ready"}, {"met", stage_ == PartStage::kReady}});
}

/// The first part has gone.
void Meeting::lose() {
  if (welcome_ && stage_ != PartStage::kReported) {
    log::warn(
        "part '{}' has gone: {}", request_.set_up.hosts.front(),
        start_ns_ != 0 ? "what it sends is lost until it is started again" : "waiting for it");
    if (start_ns_ != 0) ++deaths_[request_.set_up.hosts.front()];
  }
  line_.reset();
  welcome_ = false;
}

/// It is time to look for the first part.
bool Meeting::wants_line() {
  const std::int64_t now = now_ns();
  if (line_ || now - sought_ns_ < kSeekNs || thanked_ || error_) return false;
  sought_ns_ = now;
  return true;
}

/// Hears the first part, where there is one; `fresh`: a new connection to it.
void Meeting::seek(UniqueFd fresh) {
  const std::int64_t now = now_ns();
  if (fresh) {
    send_at_once(fresh.get());
    line_.emplace();
    line_->socket = std::move(fresh);
    heard_ns_ = told_ns_ = now;
  }
  if (!line_) return;
  const bool there = receive(line_->socket.get(), line_->frames);
  while (line_) {
    const auto message = line_->frames.next(kMostFrameBytes);
    if (!message) break;
    heard_ns_ = now_ns();
    heard(*message);
  }
  if (line_ && (!there || line_->frames.bad() || now_ns() - heard_ns_ > kPartSilenceNs))
    return lose();
  if (!line_ || !welcome_ || now - told_ns_ < kAliveNs) return;
  told_ns_ = now;
  tell({{"is", "alive"}});
}

void Meeting::heard(const Json& message) {
  const std::string is = message.at("is").text().value_or("");
  if (is == "clock") {
    tell({{"is", "hello"},
          {"host", request_.set_up.own.host},
          {"hash", request_.set_up.own.hash},
          {"tai_offset_s", request_.set_up.own.tai_offset_s},
          {"clock_ns", message.at("tai_ns").integer()},
          {"tai_ns", this->now().tai_ns},
          {"run", run_},
          {"start_tai_ns", start_tai_ns_}});
  } else if (is == "welcome") {
    const auto run = static_cast<std::uint64_t>(
        std::max<std::int64_t>(0, message.at("run").integer().value_or(0)));
    if (run == 0 || (run_ != 0 && run != run_)) {
      error_ = {ErrorCode::kUnavailable, "the other parts are in another run", "--meet",
                "start this part again"};
      return;
    }
    run_ = run;
    welcome_ = true;
    start_at(message.at("start_tai_ns").integer().value_or(0));
    tell_stage();
  } else if (is == "start") {
    start_at(message.at("start_tai_ns").integer().value_or(0));
  } else if (is == "thanks") {
    thanked_ = true;
  } else if (is == "gone") {
    const std::string host = message.at("host").text().value_or("");
    if (std::ranges::find(request_.set_up.hosts, host) == request_.set_up.hosts.end()) return;
    ++deaths_[host];
    log::warn("part '{}' has gone: what it sends is lost until it is started again", host);
  } else if (is == "refused") {
    // One that runs goes on: the first part that is there now may be another run's.
    if (start_ns_ == 0)
      error_ = {ErrorCode::kInvalid,
                "the part of '" + request_.set_up.hosts.front() +
                    "' refuses this one: " + message.at("why").text().value_or(""),
                "--meet", ""};
    line_.reset();
    welcome_ = false;
  }
}

// ---- the end -----------------------------------------------------------------------------------

void Meeting::end(const std::string& report, std::int64_t patience_ns) {
  const std::int64_t limit = now_ns() + (leads_ ? patience_ns : std::min(patience_ns, kThanksNs));
  {
    const Guard lock(mutex_);
    stage_ = PartStage::kReported;
    report_ = report;
    if (!leads_) tell_stage();
  }
  for (; now_ns() < limit; sleep_until_ns(now_ns() + 10'000'000)) {
    const Guard lock(mutex_);
    if (leads_ ? !table_.expects_reports() : thanked_ || !line_) break;
  }
  quit_.store(true);
  signal_eventfd(wake_.get());
  if (thread_.joinable()) thread_.join();
}

std::map<std::string, std::string> Meeting::reports() const {
  const Guard lock(mutex_);
  return table_.reports();
}

void Meeting::tell_steps(runtime::Account& into) const {
  const Guard lock(mutex_);
  into.add("clock_step", steps_,
           steps_ == 0 ? std::string()
                       : fmt::format("the clock of '{}' was set {} time{}, by up to {:.6f} s",
                                     request_.set_up.own.host, steps_, steps_ == 1 ? "" : "s",
                                     static_cast<double>(longest_step_ns_) * 1e-9));
}

void Meeting::report(runtime::Account& into, std::vector<std::string>& notes) const {
  const Guard lock(mutex_);
  std::uint64_t deaths = 0;
  std::vector<std::string> words;
  for (const auto& [host, count] : leads_ ? table_.deaths() : deaths_) {
    deaths += count;
    words.push_back(
        fmt::format("part '{}' was gone {} time{}", host, count, count == 1 ? "" : "s"));
  }
  into.add("part_gone", deaths, std::move(words));
  if (!leads_)
    return notes.push_back(
        thanked_ ? "the report of all parts is that of '" + request_.set_up.hosts.front() + "'"
                 : "'" + request_.set_up.hosts.front() + "' did not take this part's report");
  for (const std::string& host : request_.set_up.hosts)
    if (host != request_.set_up.own.host && !table_.reports().contains(host))
      notes.push_back("part '" + host + "' has not reported: what it did is not in this report");
}

}  // namespace xauto::launch
