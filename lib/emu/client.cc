// SPDX-License-Identifier: Apache-2.0
#include "emu/client.h"

#include <cstdlib>
#include <cstring>
#include <optional>

#include <poll.h>

#include "base/clock.h"
#include "base/socket.h"
#include "emu/driver_queue.h"
#include "emu/protocol.h"

namespace xauto::emu {
namespace {

constexpr std::int64_t kControlTimeoutNs = 1'000'000'000;

tl::unexpected<Error> gone() {
  return fail(ErrorCode::kUnavailable, "the emulator (xauto-emud) is gone");
}

Result<UniqueFd> connect_emud() {
  const char* address = std::getenv(kEmudVariable);
  if (address == nullptr)
    return fail(ErrorCode::kUnavailable, "there is no emulator in this session", {},
                "run the app with `xauto run --emulate`, or on a platform that this machine lacks");
  return connect_abstract(address);
}

Result<Packet> receive(int socket) {
  Packet packet;
  const auto size = receive_packet(socket, &packet, sizeof packet);
  if (!size) return gone();
  if (*size != sizeof packet)
    return fail(ErrorCode::kInvalid, "the emulator sent a malformed packet");
  packet.name[kMaxDeviceName - 1] = '\0';
  return packet;
}

Status error_of(const Packet& packet) {
  return fail(packet.value >= 0 && packet.value <= static_cast<int>(ErrorCode::kInternal)
                  ? static_cast<ErrorCode>(packet.value)
                  : ErrorCode::kInternal,
              packet.name, "xauto-emud");
}

}  // namespace

/// Work goes to xauto-emud, or, where the run is with the emulator modules, to a driver's node.
struct Context::Connection {
  std::optional<DriverQueue> driver;
  bool gpu = false;
  UniqueFd socket;
  std::uint32_t context = 0;
  std::uint64_t tag = 0;
};

Context::Context(std::unique_ptr<Connection> connection) : connection_(std::move(connection)) {}
Context::Context(Context&&) noexcept = default;
Context& Context::operator=(Context&&) noexcept = default;
Context::~Context() = default;

Result<Context> Context::open(const XpuId& xpu) {
  const char* drivers = std::getenv(kDriversVariable);
  if (drivers != nullptr && std::strcmp(drivers, "1") == 0 && xpu.type != XPU::CPU) {
    auto connection = std::make_unique<Connection>();
    connection->gpu = xpu.type == XPU::GPU;
    XAUTO_ASSIGN(connection->driver,
                 connection->gpu ? DriverQueue::open_gpu() : DriverQueue::open_dla(xpu.index));
    return Context(std::move(connection));
  }
  const char* pool = std::getenv(kCpuPoolVariable);
  const bool pooled = pool != nullptr && std::strcmp(pool, "1") == 0 && xpu.type == XPU::CPU;
  const std::string device = pooled ? xpu.type.type() : xpu.name;
  if (device.size() >= kMaxDeviceName)
    return fail(ErrorCode::kInvalid, "XPU name is too long to be emulated", device);
  auto connection = std::make_unique<Connection>();
  XAUTO_ASSIGN(connection->socket, connect_emud());
  Packet packet{.op = static_cast<std::uint32_t>(Op::kOpen), .value = kEmuVersion};
  std::memcpy(packet.name, device.data(), device.size());
  XAUTO_TRY(send_packet(connection->socket.get(), &packet, sizeof packet));
  XAUTO_ASSIGN(const Packet answer, receive(connection->socket.get()));
  if (answer.op == static_cast<std::uint32_t>(Op::kError))
    return tl::unexpected<Error>(error_of(answer).error());
  if (answer.op != static_cast<std::uint32_t>(Op::kOpened))
    return fail(ErrorCode::kInvalid, "the emulator answered with something else", device);
  connection->context = answer.context;
  return Context(std::move(connection));
}

Status Context::run(std::chrono::microseconds duration) {
  Connection& c = *connection_;
  if (c.driver) {
    XAUTO_TRY(c.driver->submit(duration));
    XAUTO_TRY(c.driver->wait());
    return {};
  }
  const Packet packet{.op = static_cast<std::uint32_t>(Op::kSubmit),
                      .context = c.context,
                      .tag = ++c.tag,
                      .value = duration.count() * 1000};
  if (!send_packet(c.socket.get(), &packet, sizeof packet)) return gone();
  for (;;) {
    XAUTO_ASSIGN(const Packet answer, receive(c.socket.get()));
    if (answer.tag != c.tag) continue;
    if (answer.op == static_cast<std::uint32_t>(Op::kDone)) return {};
    if (answer.op == static_cast<std::uint32_t>(Op::kError)) return error_of(answer);
  }
}

SchedHandle Context::handle() const {
  // As opaque as a CUcontext: the runtime has to find the TSG behind it.
  if (connection_->driver)
    return connection_->gpu ? SchedHandle::cuda_context(connection_.get())
                            : SchedHandle::cudla_device(connection_.get());
  return SchedHandle::emulated(connection_->context);
}

Result<Control> Control::connect() {
  XAUTO_ASSIGN(UniqueFd socket, connect_emud());
  return Control(std::move(socket));
}

Status Control::request(std::uint32_t op, std::uint32_t answer_op, std::uint32_t context) {
  const Packet packet{.op = op, .context = context, .tag = ++tag_};
  if (!send_packet(socket_.get(), &packet, sizeof packet)) return gone();
  const std::int64_t limit = now_ns() + kControlTimeoutNs;
  for (;;) {
    pollfd ready{socket_.get(), POLLIN, 0};
    const std::int64_t left_ms = (limit - now_ns()) / 1'000'000;
    if (left_ms <= 0) return fail(ErrorCode::kTimeout, "the emulator did not answer within 1 s");
    if (poll(&ready, 1, static_cast<int>(left_ms)) <= 0) continue;
    XAUTO_ASSIGN(const Packet answer, receive(socket_.get()));
    if (answer.tag != tag_) continue;  // the late answer to a request that timed out
    if (answer.op == answer_op) return {};
    if (answer.op == static_cast<std::uint32_t>(Op::kError)) return error_of(answer);
  }
}

Status Control::suspend(std::uint32_t context) {
  return request(static_cast<std::uint32_t>(Op::kSuspend),
                 static_cast<std::uint32_t>(Op::kSuspended), context);
}

Status Control::resume(std::uint32_t context) {
  return request(static_cast<std::uint32_t>(Op::kResume), static_cast<std::uint32_t>(Op::kResumed),
                 context);
}

}  // namespace xauto::emu
