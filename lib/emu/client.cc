// SPDX-License-Identifier: Apache-2.0
#include "emu/client.h"

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <sstream>
#include <string>

#include <poll.h>

#include "base/clock.h"
#include "base/socket.h"
#include "emu/driver_queue.h"
#include "emu/machine.h"
#include "emu/protocol.h"

namespace xauto::emu {
namespace {

tl::unexpected<Error> gone() {
  return fail(ErrorCode::kUnavailable, "the emulator (xauto-emud) is gone");
}

Site site_of_environment() {
  const auto text = [](const char* variable) {
    const char* value = std::getenv(variable);
    return std::string(value == nullptr ? "" : value);
  };
  const auto ids = [&](const char* variable) {
    std::set<std::string> found;
    std::istringstream lines(text(variable));
    for (std::string id; std::getline(lines, id);) found.insert(id);
    return found;
  };
  return {text(kEmudVariable), ids(kRealVariable), ids(kDriversVariable),
          text(kCpuPoolVariable) == "1"};
}

thread_local std::shared_ptr<const Site> t_site;

Result<std::string> emud_address(const Site& site) {
  if (!site.address.empty()) return site.address;
  return fail(ErrorCode::kUnavailable, "there is no emulator in this session", {},
              "run the app with `xauto run --emulate`, or on a platform that this machine lacks; "
              "with App::run open contexts in init or exec");
}

/// kUnavailable: the connection is at its end; kTimeout: nothing came before `limit_ns`.
Result<Packet> receive(int socket, std::int64_t limit_ns) {
  for (;;) {
    if (limit_ns != INT64_MAX) {
      pollfd ready{socket, POLLIN, 0};
      const std::int64_t left_ms = (limit_ns - now_ns() + 999'999) / 1'000'000;
      if (left_ms <= 0) return fail(ErrorCode::kTimeout, "the emulator did not answer in time");
      if (poll(&ready, 1, static_cast<int>(left_ms)) <= 0) continue;
    }
    Packet packet;
    XAUTO_ASSIGN(const std::size_t size, receive_packet(socket, &packet, sizeof packet));
    if (size != sizeof packet)
      return fail(ErrorCode::kInvalid, "the emulator sent a malformed packet");
    packet.name[kMaxDeviceName - 1] = '\0';
    return packet;
  }
}

/// Keeps the calling thread's CPU busy until the thread has had it for so long.
void burn(std::int64_t work_ns) {
  const std::int64_t end = clock_ns(CLOCK_THREAD_CPUTIME_ID) + work_ns;
  while (clock_ns(CLOCK_THREAD_CPUTIME_ID) < end) {
  }
}

bool is(const Packet& packet, Op op) {
  return packet.op == static_cast<std::uint32_t>(op);
}

/// Sends `request` and waits for its answer; an emulator that dies before it is followed by
/// another one, or the connection is refused and it is gone. Only what may be asked twice.
Result<Packet> ask_until_answered(const std::string& address, UniqueFd& socket,
                                  const Packet& request) {
  const std::int64_t limit_ns = now_ns() + kComeBackNs;
  for (;;) {
    if (!socket) {
      auto connected = connect_abstract(address);
      if (!connected) return gone();
      socket = std::move(*connected);
    }
    if (send_packet(socket.get(), &request, sizeof request)) {
      auto answer = receive(socket.get(), limit_ns);
      if (answer) return answer;
      if (answer.error().code == ErrorCode::kTimeout) return gone();
      if (answer.error().code != ErrorCode::kUnavailable) return answer;
    }
    socket.reset();
  }
}

Status error_of(const Packet& packet) {
  return fail(packet.value >= 0 && packet.value <= static_cast<int>(ErrorCode::kInternal)
                  ? static_cast<ErrorCode>(packet.value)
                  : ErrorCode::kInternal,
              packet.name, "xauto-emud");
}

}  // namespace

std::shared_ptr<const Site> this_threads_site() {
  return t_site ? t_site : std::make_shared<const Site>(site_of_environment());
}

void set_this_threads_site(std::shared_ptr<const Site> site) {
  t_site = std::move(site);
}

/// Work goes to a clock, or to xauto-emud, or, where the run is with the emulator modules, to a driver's node; on
/// a CPU that is real it keeps that CPU busy.
struct Context::Connection {
  std::shared_ptr<const Site> virtual_site;  ///< with a clock; else null
  bool real_cpu = false;
  std::optional<DriverQueue> driver;
  bool gpu = false;
  std::string address;
  UniqueFd socket;
  std::uint32_t context = 0;
  std::int64_t key = 0;
  std::uint64_t tag = 0;

  [[nodiscard]] Status submit_and_wait(std::int64_t work_ns);
  /// At the next emulator, after the death of ours: what became of the call `tag`.
  [[nodiscard]] Result<Progress> rejoin();
};

Context::Context(std::unique_ptr<Connection> connection) : connection_(std::move(connection)) {}
Context::Context(Context&&) noexcept = default;
Context& Context::operator=(Context&&) noexcept = default;
Context::~Context() = default;

Result<Context> Context::open(const XpuId& xpu) {
  const std::shared_ptr<const Site> site = this_threads_site();
  if (site->virtual_ns != nullptr) {
    auto connection = std::make_unique<Connection>();
    connection->virtual_site = site;
    return Context(std::move(connection));
  }
  if (site->drivers.contains(xpu.name)) {
    auto connection = std::make_unique<Connection>();
    connection->gpu = xpu.type == XPU::GPU;
    XAUTO_ASSIGN(connection->driver,
                 connection->gpu ? DriverQueue::open_gpu() : DriverQueue::open_dla(xpu.index));
    return Context(std::move(connection));
  }
  if (site->real.contains(xpu.name)) {
    if (xpu.type != XPU::CPU)
      return fail(ErrorCode::kUnavailable, "is real in this run, the emulator does not have it",
                  xpu.name, "have it emulated with --emulate " + xpu.type.type());
    auto connection = std::make_unique<Connection>();
    connection->real_cpu = true;
    return Context(std::move(connection));
  }
  const bool pooled = site->cpu_pool && xpu.type == XPU::CPU;
  const std::string device = pooled ? xpu.type.type() : xpu.name;
  if (device.size() >= kMaxDeviceName)
    return fail(ErrorCode::kInvalid, "XPU name is too long to be emulated", device);
  auto connection = std::make_unique<Connection>();
  XAUTO_ASSIGN(connection->address, emud_address(*site));
  XAUTO_ASSIGN(connection->socket, connect_abstract(connection->address));
  Packet packet{.op = static_cast<std::uint32_t>(Op::kOpen), .value = kEmuVersion};
  std::memcpy(packet.name, device.data(), device.size());
  XAUTO_ASSIGN(const Packet answer,
               ask_until_answered(connection->address, connection->socket, packet));
  if (is(answer, Op::kError)) return tl::unexpected<Error>(error_of(answer).error());
  if (!is(answer, Op::kOpened))
    return fail(ErrorCode::kInvalid, "the emulator answered with something else", device);
  connection->context = answer.context;
  connection->key = answer.value;
  return Context(std::move(connection));
}

Status Context::run(std::chrono::microseconds duration) {
  Connection& c = *connection_;
  if (c.virtual_site) {
    *c.virtual_site->virtual_ns += duration.count() * 1000;
    return {};
  }
  if (c.real_cpu) {
    burn(duration.count() * 1000);
    return {};
  }
  if (c.driver) {
    XAUTO_TRY(c.driver->submit(duration));
    XAUTO_TRY(c.driver->wait());
    return {};
  }
  ++c.tag;
  return c.submit_and_wait(duration.count() * 1000);
}

/// Whenever the emulator dies, the context is taken up again at the next one, which tells whether
/// the work is done, goes on, or has to be submitted (again).
Status Context::Connection::submit_and_wait(std::int64_t work_ns) {
  const Packet packet{.op = static_cast<std::uint32_t>(Op::kSubmit),
                      .context = context,
                      .tag = tag,
                      .value = work_ns};
  Progress progress = Progress::kUnknown;
  for (;;) {
    if (progress == Progress::kDone) return {};
    if (progress == Progress::kUnderWay ||
        (socket && send_packet(socket.get(), &packet, sizeof packet))) {
      auto answer = receive(socket.get(), INT64_MAX);
      while (answer && answer->tag != tag) answer = receive(socket.get(), INT64_MAX);
      if (answer && is(*answer, Op::kDone)) return {};
      if (answer && is(*answer, Op::kError)) return error_of(*answer);
      if (answer) return fail(ErrorCode::kInvalid, "the emulator answered with something else");
      if (answer.error().code != ErrorCode::kUnavailable)
        return tl::unexpected<Error>(answer.error());
    }
    XAUTO_ASSIGN(progress, rejoin());
  }
}

Result<Progress> Context::Connection::rejoin() {
  socket.reset();
  const Packet packet{
      .op = static_cast<std::uint32_t>(Op::kRejoin), .context = context, .tag = tag, .value = key};
  XAUTO_ASSIGN(const Packet answer, ask_until_answered(address, socket, packet));
  if (is(answer, Op::kError)) return tl::unexpected<Error>(error_of(answer).error());
  if (!is(answer, Op::kRejoined) || answer.value < 0 ||
      answer.value > static_cast<std::int64_t>(Progress::kDone))
    return fail(ErrorCode::kInvalid, "the emulator answered with something else");
  return static_cast<Progress>(answer.value);
}

SchedHandle Context::handle() const {
  if (connection_->real_cpu) return SchedHandle::thread();
  // As opaque as a CUcontext: the runtime has to find the TSG behind it.
  if (connection_->driver)
    return connection_->gpu ? SchedHandle::cuda_context(connection_.get())
                            : SchedHandle::cudla_device(connection_.get());
  return SchedHandle::emulated(connection_->context);
}

Result<Control> Control::connect() {
  XAUTO_ASSIGN(std::string address, emud_address(*this_threads_site()));
  XAUTO_ASSIGN(UniqueFd socket, connect_abstract(address));
  return Control(std::move(address), std::move(socket));
}

/// Asked of every emulator until one has answered: suspending twice is suspending once.
Status Control::request(std::uint32_t op, std::uint32_t answer_op, std::uint32_t context,
                        std::int64_t value) {
  XAUTO_TRY(ask({.op = op, .context = context, .tag = ++tag_, .value = value}, answer_op));
  return {};
}

Result<std::int64_t> Control::ask(const Packet& packet, std::uint32_t answer_op) {
  std::int64_t limit_ns = now_ns() + kComeBackNs;
  bool asked = socket_ && send_packet(socket_.get(), &packet, sizeof packet);
  for (;;) {
    if (!asked) {
      socket_.reset();
      auto connected = connect_abstract(address_);
      if (!connected) return gone();
      socket_ = std::move(*connected);
      asked = send_packet(socket_.get(), &packet, sizeof packet).has_value();
      limit_ns = now_ns() + kComeBackNs;
      continue;
    }
    const auto answer = receive(socket_.get(), limit_ns);
    if (!answer && answer.error().code == ErrorCode::kUnavailable) {
      asked = false;
      continue;
    }
    if (!answer) return tl::unexpected<Error>(answer.error());
    if (answer->tag != tag_) continue;  // the late answer to a request that timed out
    if (answer->op == answer_op) return answer->value;
    if (is(*answer, Op::kError)) return tl::unexpected<Error>(error_of(*answer).error());
  }
}

Result<std::int64_t> Control::busy_ns(const std::string& xpu) {
  Packet packet{.op = static_cast<std::uint32_t>(Op::kBusy), .tag = ++tag_};
  if (xpu.size() >= kMaxDeviceName)
    return fail(ErrorCode::kInvalid, "XPU name is too long to be emulated", xpu);
  std::memcpy(packet.name, xpu.data(), xpu.size());
  return ask(packet, static_cast<std::uint32_t>(Op::kBusied));
}

Status Control::suspend(std::uint32_t context) {
  const Status done = request(static_cast<std::uint32_t>(Op::kSuspend),
                              static_cast<std::uint32_t>(Op::kSuspended), context);
  if (!done && done.error().code == ErrorCode::kTimeout) {
    // It may still come to it, and nobody would resume what nobody takes for suspended.
    const Packet undo{
        .op = static_cast<std::uint32_t>(Op::kResume), .context = context, .tag = ++tag_};
    (void)send_packet(socket_.get(), &undo, sizeof undo);
  }
  return done;
}

Status Control::resume(std::uint32_t context) {
  return request(static_cast<std::uint32_t>(Op::kResume), static_cast<std::uint32_t>(Op::kResumed),
                 context);
}

Status Control::level(std::uint32_t context, int level) {
  return request(static_cast<std::uint32_t>(Op::kLevel), static_cast<std::uint32_t>(Op::kLeveled),
                 context, level);
}

}  // namespace xauto::emu
