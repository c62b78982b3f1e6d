// SPDX-License-Identifier: Apache-2.0
#include "coord/port.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstring>

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/socket.h"
#include "coord/protocol.h"

namespace xauto::coord {

Result<std::unique_ptr<Port>> Port::connect(
    const std::string& address, const std::string& worker, const std::vector<std::uint32_t>& xnodes,
    const std::vector<std::pair<std::uint32_t, std::uint32_t>>& order) {
  const std::string where = "coordinator '" + address + "'";
  if (xnodes.size() > kMaxWorkerXNodes)
    return fail(ErrorCode::kInvalid,
                "worker '" + worker + "' has " + std::to_string(xnodes.size()) +
                    " XNodes, at most " + std::to_string(kMaxWorkerXNodes) + " are possible",
                where);
  auto port = std::unique_ptr<Port>(new Port);
  XAUTO_ASSIGN(port->socket_, connect_abstract(address));

  Hello hello;
  std::strncpy(hello.worker, worker.c_str(), kMaxWorkerName - 1);
  hello.num_xnodes = static_cast<std::uint32_t>(xnodes.size());
  std::copy(xnodes.begin(), xnodes.end(), hello.xnodes);
  XAUTO_TRY(send_packet(port->socket_.get(), &hello, sizeof hello));

  std::vector<UniqueFd> fds;
  Refused answer;  // the largest of the possible answers
  XAUTO_ASSIGN(const std::size_t size,
               receive_packet(port->socket_.get(), &answer, sizeof answer, &fds));
  if (size == sizeof(Refused) && answer.kind == static_cast<std::uint32_t>(MessageKind::kRefused)) {
    answer.reason[sizeof answer.reason - 1] = '\0';
    return fail(ErrorCode::kUnavailable, std::string("refused the worker: ") + answer.reason,
                where);
  }
  Welcome welcome;
  if (size != sizeof welcome || fds.size() != 3)
    return fail(ErrorCode::kUnavailable, "answered with an unknown message", where);
  std::memcpy(&welcome, static_cast<const void*>(&answer), sizeof welcome);
  port->doorbell_ = std::move(fds[1]);
  port->commands_ = std::move(fds[2]);

  struct stat status {};
  if (fstat(fds[0].get(), &status) != 0 || static_cast<std::size_t>(status.st_size) < Shm::bytes(0))
    return fail(ErrorCode::kUnavailable, "shared memory is cut short", where);
  port->bytes_ = static_cast<std::size_t>(status.st_size);
  void* memory = mmap(nullptr, port->bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE,
                      fds[0].get(), 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno), where);
  port->shm_ = Shm::at(memory);
  const Header& header = *port->shm_.header;
  if (header.magic != kShmMagic || header.version != kShmVersion ||
      header.num_xnodes > kMaxSharedXNodes || port->bytes_ < Shm::bytes(header.num_xnodes) ||
      welcome.slot >= static_cast<std::uint32_t>(kMaxSlots))
    return fail(ErrorCode::kUnavailable, "shared memory has another version than this library",
                where, "use xauto-coordinator and libxauto of one build");
  port->slot_ = static_cast<int>(welcome.slot);
  port->discipline_ = static_cast<Discipline>(header.discipline);
  port->generation_ = request_generation(port->shm_.slots[port->slot_].worker.request.load());

  port->before_.resize(header.num_xnodes);
  port->tracked_.resize(header.num_xnodes);
  for (const auto& [u, v] : order) {
    if (u >= header.num_xnodes || v >= header.num_xnodes)
      return fail(ErrorCode::kInvalid, "order names an XNode beyond the app's", where);
    port->before_[v].push_back(u);
    port->tracked_[u] = 1;
  }
  port->interrupt_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!port->interrupt_) return fail(ErrorCode::kIo, std::string("eventfd: ") + strerror(errno));
  return port;
}

Port::~Port() {
  if (shm_.header != nullptr) munmap(shm_.header, bytes_);
}

bool Port::eligible(const Job& job) const {
  if (job.xnode >= before_.size()) return true;
  const auto& before = before_[job.xnode];
  return std::all_of(before.begin(), before.end(), [&](std::uint32_t u) {
    return shm_.finished[u].load(std::memory_order_seq_cst) > job.sequence;
  });
}

void Port::start(const Job& job) {
  job_ = job;
  if (lost()) return;
  WorkerLine& line = shm_.slots[slot_].worker;
  line.xnode.store(job.xnode, std::memory_order_relaxed);
  line.priority.store(job.priority, std::memory_order_relaxed);
  line.sequence.store(job.sequence, std::memory_order_relaxed);
  line.since_ns.store(static_cast<std::uint64_t>(now_ns()), std::memory_order_relaxed);
  generation_ = (generation_ + 1) & kGenerationMask;

  std::atomic<std::uint64_t>& owner = shm_.header->owner;
  if (discipline_ == Discipline::kKernel && eligible(job)) {
    line.request.store(request_word(Want::kRuns, generation_), std::memory_order_seq_cst);
    return;
  }
  line.request.store(request_word(Want::kRun, generation_), std::memory_order_seq_cst);
  std::uint64_t seen = owner.load(std::memory_order_seq_cst);
  while ((seen & kContended) == 0) {
    if (seen == 0 && discipline_ != Discipline::kKernel && eligible(job)) {
      if (owner.compare_exchange_weak(seen, owner_word(slot_, generation_))) return;
    } else {
      if (owner.compare_exchange_weak(seen, seen | kContended)) break;
    }
  }
  ring();
  wait_for_grant();
}

void Port::wait_for_grant() {
  std::atomic<std::uint32_t>& grant = shm_.slots[slot_].coordinator.grant;
  while (!lost() && !interrupted_.load(std::memory_order_relaxed)) {
    const std::uint32_t seen = grant.load(std::memory_order_acquire);
    if (seen == generation_) return;
    futex_wait(grant, seen);
  }
}

void Port::mark_finished(std::uint32_t xnode, std::uint64_t count) {
  std::atomic<std::uint64_t>& finished = shm_.finished[xnode];
  std::uint64_t seen = finished.load(std::memory_order_relaxed);
  while (seen < count && !finished.compare_exchange_weak(seen, count, std::memory_order_seq_cst)) {
  }
}

void Port::finish() {
  if (lost()) return;
  if (job_.xnode < tracked_.size() && tracked_[job_.xnode])
    mark_finished(job_.xnode, job_.sequence + 1);
  WorkerLine& line = shm_.slots[slot_].worker;
  line.request.store(request_word(Want::kIdle, generation_), std::memory_order_seq_cst);
  std::atomic<std::uint64_t>& owner = shm_.header->owner;
  if (discipline_ == Discipline::kKernel) {
    if ((owner.load(std::memory_order_seq_cst) & kContended) != 0) ring();
    return;
  }
  std::uint64_t mine = owner_word(slot_, generation_);
  if (!owner.compare_exchange_strong(mine, 0)) ring();
}

void Port::skip(std::uint32_t xnode, std::uint64_t sequence) {
  if (lost() || xnode >= tracked_.size() || !tracked_[xnode]) return;
  mark_finished(xnode, sequence + 1);
  if ((shm_.header->owner.load(std::memory_order_seq_cst) & kContended) != 0) ring();
}

void Port::ring() {
  shm_.header->rings.fetch_add(1, std::memory_order_seq_cst);
  if (shm_.header->waiting.exchange(0, std::memory_order_seq_cst) != 0)
    signal_eventfd(doorbell_.get());
}

Command Port::wait_command(int timeout_ms) {
  const CoordinatorLine& line = shm_.slots[slot_].coordinator;
  for (;;) {
    if (interrupted_.load(std::memory_order_relaxed)) return Command::kInterrupted;
    const std::uint32_t command = line.command.load(std::memory_order_acquire);
    if (command != pending_command_) {
      pending_command_ = command;
      return (command & 1u) != 0 ? Command::kSuspend : Command::kResume;
    }
    pollfd fds[3] = {{commands_.get(), POLLIN, 0},
                     {interrupt_.get(), POLLIN, 0},
                     {lost() ? -1 : socket_.get(), POLLIN, 0}};
    const int ready = poll(fds, 3, timeout_ms);
    if (ready == 0) return Command::kNothing;
    if (ready < 0) continue;  // EINTR
    if (fds[0].revents != 0) drain_eventfd(commands_.get());
    // The coordinator sends nothing after Welcome: anything here is its end, or its ruin.
    if (fds[2].revents != 0) {
      lost_.store(true);
      futex_wake(shm_.slots[slot_].coordinator.grant, INT_MAX);
      return Command::kLost;
    }
  }
}

void Port::acknowledge(bool succeeded) {
  shm_.slots[slot_].worker.ack.store(pending_command_ | (succeeded ? 0u : kAckFailed),
                                     std::memory_order_seq_cst);
  ring();
}

void Port::interrupt() {
  interrupted_.store(true);
  signal_eventfd(interrupt_.get());
  futex_wake(shm_.slots[slot_].coordinator.grant, INT_MAX);
}

}  // namespace xauto::coord
