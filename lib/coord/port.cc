// SPDX-License-Identifier: Apache-2.0
#include "coord/port.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <climits>
#include <cstring>

#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/socket.h"
#include "coord/protocol.h"

namespace xauto::coord {
namespace {

/// As WorkerLine::acked_us has it.
std::uint32_t low_us(std::int64_t ns) {
  return static_cast<std::uint32_t>(ns / 1000);
}

/// How long to knock at a successor's door. While the parent of the run lives, it either starts one,
/// again if that hangs (launch/pulse.h), or closes the door, which ends this at once: so the limit is
/// for a parent that hangs, and generous to a machine that stalls.
constexpr int kRejoinMs = 30'000;
constexpr int kLookMs = 50;  ///< for whether the run ends meanwhile

}  // namespace

Result<std::unique_ptr<Port>> Port::connect(const std::string& address, const std::string& worker,
                                            const std::vector<std::uint32_t>& xnodes,
                                            const OrderPairs& order, int fifo, int timeout_ms) {
  const std::string where = "coordinator '" + address + "'";
  if (xnodes.size() > kMaxWorkerXNodes)
    return fail(ErrorCode::kInvalid,
                "worker '" + worker + "' has " + std::to_string(xnodes.size()) +
                    " XNodes, at most " + std::to_string(kMaxWorkerXNodes) + " are possible",
                where);
  auto port = std::unique_ptr<Port>(new Port);
  XAUTO_ASSIGN(port->door_, parse_door(address));
  port->first_xnode_ = port->door_.lease.first_xnode;
  if (port->door_.shared() && !order.empty())
    return fail(ErrorCode::kInvalid, "keeps no order pairs: it serves several runs", where);
  Hello& hello = port->hello_;
  std::strncpy(hello.worker, worker.c_str(), kMaxWorkerName - 1);
  hello.num_xnodes = static_cast<std::uint32_t>(xnodes.size());
  std::transform(xnodes.begin(), xnodes.end(), hello.xnodes,
                 [&](std::uint32_t own) { return own + port->first_xnode_; });
  hello.num_order = static_cast<std::uint32_t>(order.size());
  XAUTO_TRY(port->introduce(hello, timeout_ms));

  struct stat status {};
  const int memory_fd = port->memory_.get();
  if (fstat(memory_fd, &status) != 0 || static_cast<std::size_t>(status.st_size) < Shm::bytes(0))
    return fail(ErrorCode::kUnavailable, "shared memory is cut short", where);
  port->bytes_ = static_cast<std::size_t>(status.st_size);
  void* memory =
      mmap(nullptr, port->bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, memory_fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno), where);
  port->shm_ = Shm::at(memory);
  const Header& header = *port->shm_.header;
  if (header.magic != kShmMagic || header.version != kShmVersion ||
      header.num_xnodes > kMaxSharedXNodes || port->bytes_ < Shm::bytes(header.num_xnodes) ||
      port->slot_ >= kMaxSlots)
    return fail(ErrorCode::kUnavailable, "shared memory has another version than this library",
                where, "use xauto-coordinator and libxauto of one build");
  for (const auto& [u, v] : order)
    if (u >= header.num_xnodes || v >= header.num_xnodes)
      return fail(ErrorCode::kInvalid, "order names an XNode beyond the app's", where);
  port->rules_ = {static_cast<Discipline>(header.discipline), Order(order),
                  static_cast<int>(header.levels)};
  port->words_ = Words<RealAtomics>(port->shm_, &port->rules_);
  port->generation_ = request_generation(port->shm_.slots[port->slot_].worker.request.load());
  port->pending_command_ = port->shm_.slots[port->slot_].coordinator.command.load();
  if (port->record_fd_) {
    XAUTO_ASSIGN(port->record_, Record::map(port->record_fd_.get(), true));
    port->record_fd_.reset();
  }
  XAUTO_ASSIGN(port->watch_, SocketWatch::of_process(fifo));
  XAUTO_TRY(port->watch_socket());
  return port;
}

/// Hello and its answer, on a new socket.
Status Port::introduce(const Hello& hello, int timeout_ms) {
  const std::string where = "coordinator '" + door_.name + "'";
  XAUTO_ASSIGN(UniqueFd socket, open_door(door_));
  // Where the machine's service has refused it meanwhile, its answer is there all the same.
  if (Status sent = send_packet(socket.get(), &hello, sizeof hello); !sent && !door_.shared())
    return sent;
  for (int left = timeout_ms; timeout_ms >= 0 && !wait_readable(socket.get(), kLookMs);
       left -= kLookMs)
    if (left <= 0 || interrupted_.load()) return fail(ErrorCode::kTimeout, "did not answer", where);
  std::vector<UniqueFd> fds;
  Refused answer;  // the largest of the possible answers
  XAUTO_ASSIGN(const std::size_t size, receive_packet(socket.get(), &answer, sizeof answer, &fds));
  if (size == sizeof(Refused) && answer.kind == static_cast<std::uint32_t>(MessageKind::kRefused)) {
    answer.reason[sizeof answer.reason - 1] = '\0';
    return fail(ErrorCode::kPermission, std::string("refused the worker: ") + answer.reason, where);
  }
  Welcome welcome;
  if (size != sizeof welcome || fds.size() < 2 || fds.size() > 3)
    return fail(ErrorCode::kUnavailable, "answered with an unknown message", where);
  std::memcpy(&welcome, static_cast<const void*>(&answer), sizeof welcome);
  if (welcome.slot >= static_cast<std::uint32_t>(kMaxSlots))
    return fail(ErrorCode::kUnavailable, "answered with an unknown slot", where);
  // The execution thread uses the slot meanwhile, so one that comes back only looks at it.
  if (hello.rejoin == 0)
    slot_ = static_cast<int>(welcome.slot);
  else if (welcome.slot != static_cast<std::uint32_t>(slot_))
    return fail(ErrorCode::kUnavailable, "gave the worker another slot than its own", where);
  socket_ = std::move(socket);
  if (!memory_) {  // a coordinator that took over has the same memory and doorbell
    memory_ = std::move(fds[0]);
    doorbell_ = std::move(fds[1]);
    if (fds.size() == 3) record_fd_ = std::move(fds[2]);
  }
  return {};
}

Status Port::watch_socket() {
  ended_.store(false);
  return watch_->add(socket_.get(), [this] {
    ended_.store(true);
    ring_manager(slot_);
  });
}

/// The coordinator has died. If another one takes over, jobs never notice; they wait for its grants
/// as they did before.
bool Port::rejoin() {
  watch_->remove(socket_.get());
  Hello hello = hello_;
  hello.rejoin = static_cast<std::uint32_t>(slot_) + 1;
  const std::int64_t limit = now_ns() + std::int64_t{kRejoinMs} * 1'000'000;
  while (!interrupted_.load() && now_ns() < limit) {
    // Its address is inherited by its successor: without anybody to listen, there will be none. One behind the
    // machine's socket may die with the connection that has just been handed to it.
    const Status status = introduce(hello, kRejoinMs);
    if (status) return watch_socket().has_value();
    const ErrorCode code = status.error().code;
    if (code == ErrorCode::kPermission || (code != ErrorCode::kTimeout && !door_.shared())) break;
    if (code != ErrorCode::kTimeout) sleep_until_ns(now_ns() + std::int64_t{kLookMs} * 1'000'000);
  }
  return false;
}

Port::~Port() {
  if (watch_) watch_->remove(socket_.get());
  if (shm_.header != nullptr) munmap(shm_.header, bytes_);
}

bool Port::contended() const {
  return (shm_.header->owner.load(std::memory_order_relaxed) & (kFat | kParked)) != 0;
}

void Port::begin(const Job& job) {
  job_ = job;
  job_.xnode += first_xnode_;
  waits_ = false;
  if (lost()) return;
  generation_ = (generation_ + 1) & kGenerationMask;
  if (shm_.header->regulated != 0) {
    static thread_local const auto self = static_cast<std::uint32_t>(gettid());
    shm_.slots[slot_].coordinator.thread.store(self, std::memory_order_relaxed);
  }
  // Who came first matters only among those that meet; who meets nobody need not know so exactly.
  const bool alone = (shm_.header->owner.load(std::memory_order_relaxed) & ~kParkings) == 0;
  job_.since_ns = static_cast<std::uint64_t>(alone ? coarse_now_ns() : now_ns());
  const Start start = words_.start(slot_, generation_, job_);
  took_.store(start.started == Started::kTook || start.started == Started::kDecided,
              std::memory_order_relaxed);
  switch (start.started) {
    case Started::kRuns:
      return;
    case Started::kTook:
      ring_manager(start.victim);
      return;
    case Started::kDecided:
      ring();
      break;
    case Started::kWaits:
      break;
  }
  waits_ = true;
}

void Port::wait() {
  if (!waits_) return;
  std::atomic<std::uint32_t>& grant = shm_.slots[slot_].coordinator.grant;
  while (!lost() && !interrupted_.load(std::memory_order_relaxed)) {
    const std::uint32_t seen = grant.load(std::memory_order_acquire);
    if (seen == generation_) break;
    futex_wait(grant, seen);
  }
}

void Port::finish() {
  if (lost()) return;
  tell(words_.finish(slot_, generation_, job_));
}

/// Whoever has something to do by it.
void Port::tell(const Finished& finished) {
  for (std::uint64_t wakes = finished.wakes; wakes != 0; wakes &= wakes - 1)
    futex_wake(shm_.slots[std::countr_zero(wakes)].coordinator.grant, 1);
  if (finished.victim >= 0) ring_manager(finished.victim);
  if (finished.ring) ring();
}

std::int64_t Port::beside_ns(std::int64_t since_ns, std::int64_t until_ns) const {
  if (!took_.load(std::memory_order_relaxed) || discipline() != Discipline::kPreemptive) return 0;
  const std::int64_t ran_ns = until_ns - since_ns;
  std::int64_t beside_ns = -1;
  // The one from whom it got the XPU is the first that was suspended since.
  const int high = static_cast<int>(shm_.header->high.load(std::memory_order_relaxed));
  for (int i = 0; i < high && i < kMaxSlots; ++i) {
    const SlotMemory& slot = shm_.slots[i];
    if (i == slot_ || slot.coordinator.used.load(std::memory_order_relaxed) == 0) continue;
    const std::uint32_t command = slot.coordinator.command.load(std::memory_order_acquire);
    const std::uint32_t ack = slot.worker.ack.load(std::memory_order_acquire);
    if ((command & 1u) == 0) continue;
    const bool answered = (ack & ~kAckFailed) == command;
    if (answered && (ack & kAckFailed) != 0) continue;
    const std::int64_t after_ns =
        answered ? std::int64_t{slot.worker.acked_us.load(std::memory_order_relaxed) -
                                low_us(since_ns)} *
                       1000
                 : ran_ns;
    if (after_ns <= ran_ns && (beside_ns < 0 || after_ns < beside_ns)) beside_ns = after_ns;
  }
  return std::max<std::int64_t>(0, beside_ns);
}

void Port::tell_had(std::int64_t begin_ns, std::int64_t end_ns, std::int64_t had_ns) const {
  if (record_) record_.slot(slot_).add(begin_ns, end_ns, had_ns);
}

std::int64_t Port::others_had_ns() const {
  return record_ ? record_.others_ns(door_.lease.number) : 0;
}

Neighbours Port::neighbours() const {
  if (!door_.shared()) return {};
  const auto told = ask_machine(door_.path);
  return told ? coord::neighbours(*told) : Neighbours();
}

void Port::skip(std::uint32_t xnode, std::uint64_t sequence) {
  if (!lost()) tell(words_.skip(xnode + first_xnode_, sequence));
}

void Port::ring() {
  if (words_.ring()) signal_eventfd(doorbell_.get());
}

void Port::ring_manager(int slot) {
  futex_advance(shm_.slots[slot].coordinator.bell, 1);
}

Command Port::wait_command(int timeout_ms) {
  CoordinatorLine& line = shm_.slots[slot_].coordinator;
  const std::int64_t limit_ns = timeout_ms < 0 ? -1 : std::int64_t{timeout_ms} * 1'000'000;
  for (bool woken = true;;) {
    const std::uint32_t bell = line.bell.load();  // what is rung from here on wakes us
    if (interrupted_.load()) return Command::kInterrupted;
    const std::uint32_t command = line.command.load();
    if (command != pending_command_) {
      pending_command_ = command;
      return (command & 1u) != 0 ? Command::kSuspend : Command::kResume;
    }
    if (ended_.load() && !lost() && !rejoin()) {
      lost_.store(true);
      futex_wake(line.grant, INT_MAX);
      return Command::kLost;
    }
    if (!woken) return Command::kNothing;
    woken = futex_wait(line.bell, bell, limit_ns);
  }
}

void Port::acknowledge(bool succeeded) {
  shm_.slots[slot_].worker.acked_us.store(low_us(now_ns()), std::memory_order_relaxed);
  if (words_.acknowledge(slot_, pending_command_ | (succeeded ? 0u : kAckFailed))) ring();
}

std::optional<Port::Begun> Port::begun(std::uint32_t xnode, std::uint64_t sequence) const {
  const WorkerLine& line = shm_.slots[slot_].worker;
  const std::uint32_t request = line.request.load();
  const Want want = request_want(request);
  const std::uint32_t generation = request_generation(request);
  const bool same = line.xnode.load() == xnode + first_xnode_ && line.sequence.load() == sequence;
  const Key key = with_lent<RealAtomics>(line, generation, line.key.load());
  // The execution thread may be at its next job by now.
  if (want != Want::kRun || !same || line.request.load() != request) return std::nullopt;
  return Begun{generation, key};
}

void Port::lend(const Begun& job, Key key) {
  words_.lend(slot_, job.generation, key);
  ring();
}

void Port::interrupt() {
  interrupted_.store(true);
  ring_manager(slot_);
  futex_wake(shm_.slots[slot_].coordinator.grant, INT_MAX);
}

}  // namespace xauto::coord
