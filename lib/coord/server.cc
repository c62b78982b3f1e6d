// SPDX-License-Identifier: Apache-2.0
#include "coord/server.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstring>

#include <fcntl.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "base/socket.h"
#include "coord/protocol.h"

namespace xauto::coord {
namespace {

constexpr std::size_t kMaxConnections = 2 * kMaxSlots;

std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += static_cast<unsigned char>(c) < 0x20 ? '?' : c;
  }
  return out + "\"";
}

}  // namespace

Server::Server(ServerOptions options)
    : options_(std::move(options)), arbiter_(options_.discipline, options_.order) {
  for (const auto& [u, v] : options_.order) tracked_.push_back(u);
  std::sort(tracked_.begin(), tracked_.end());
  tracked_.erase(std::unique(tracked_.begin(), tracked_.end()), tracked_.end());
}

Server::~Server() {
  if (shm_.header != nullptr) munmap(shm_.header, bytes_);
}

Result<std::unique_ptr<Server>> Server::create(ServerOptions options) {
  if (options.xnodes.size() > kMaxSharedXNodes)
    return fail(ErrorCode::kInvalid, "more than " + std::to_string(kMaxSharedXNodes) + " XNodes");
  for (const auto& [u, v] : options.order)
    if (u >= options.xnodes.size() || v >= options.xnodes.size())
      return fail(ErrorCode::kInvalid, "order names an XNode beyond the app's");
  auto server = std::unique_ptr<Server>(new Server(std::move(options)));
  Server& s = *server;
  const auto num_xnodes = static_cast<std::uint32_t>(s.options_.xnodes.size());

  s.memory_fd_ = UniqueFd(memfd_create("xauto-coordinator", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  s.bytes_ = Shm::bytes(num_xnodes);
  if (!s.memory_fd_ || ftruncate(s.memory_fd_.get(), static_cast<off_t>(s.bytes_)) != 0)
    return fail(ErrorCode::kIo, std::string("cannot make shared memory: ") + strerror(errno));
  // Sealed: a client that shrinks it would kill us with SIGBUS.
  if (fcntl(s.memory_fd_.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0)
    return fail(ErrorCode::kIo, std::string("cannot seal shared memory: ") + strerror(errno));
  void* memory = mmap(nullptr, s.bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE,
                      s.memory_fd_.get(), 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  s.shm_ = Shm::at(memory);
  new (s.shm_.header) Header;
  for (int i = 0; i < kMaxSlots; ++i) new (s.shm_.slots + i) SlotMemory;
  for (std::uint32_t i = 0; i < num_xnodes; ++i)
    new (s.shm_.finished + i) std::atomic<std::uint64_t>(0);
  s.shm_.header->magic = kShmMagic;
  s.shm_.header->version = kShmVersion;
  s.shm_.header->num_xnodes = num_xnodes;
  s.shm_.header->discipline = static_cast<std::uint8_t>(s.options_.discipline);

  s.doorbell_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  s.epoll_ = UniqueFd(epoll_create1(EPOLL_CLOEXEC));
  if (!s.doorbell_ || !s.epoll_)
    return fail(ErrorCode::kIo, std::string("eventfd/epoll: ") + strerror(errno));
  XAUTO_ASSIGN(s.listener_, listen_abstract(s.options_.address));
  for (const int fd : {s.doorbell_.get(), s.listener_.get()}) {
    epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
    if (epoll_ctl(s.epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
      return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  }
  return server;
}

Status Server::run(int stop_fd) {
  epoll_event stop{.events = EPOLLIN, .data = {.fd = stop_fd}};
  if (epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, stop_fd, &stop) != 0)
    return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  std::array<epoll_event, 32> events;
  for (;;) {
    // Announce the sleep, then look once more: a ring before the announcement is seen by this look,
    // a ring after it writes the eventfd.
    shm_.header->waiting.store(1, std::memory_order_seq_cst);
    look();
    const int count = epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), -1);
    shm_.header->waiting.store(0, std::memory_order_seq_cst);
    if (count < 0 && errno != EINTR)
      return fail(ErrorCode::kIo, std::string("epoll_wait: ") + strerror(errno));
    for (int i = 0; i < count; ++i) {
      const int fd = events[static_cast<std::size_t>(i)].data.fd;
      if (fd == stop_fd) return {};
      if (fd == doorbell_.get()) {
        drain_eventfd(fd);
      } else if (fd == listener_.get()) {
        accept_connection();
      } else {
        Hello packet;
        const auto size = receive_packet(fd, &packet, sizeof packet);
        if (!size || !handle_packet(fd, &packet, *size)) drop(fd);
      }
    }
  }
}

// ---- joining and leaving
// -------------------------------------------------------------------------

void Server::accept_connection() {
  auto peer = accept_own(listener_.get());
  if (!peer) {
    log::warn("{}: {}", options_.xpu, peer.error().what);
    return;
  }
  if (!adopt_connection(std::move(*peer)))
    log::warn("{}: refused a connection: {} are open", options_.xpu, connections_.size());
}

bool Server::adopt_connection(UniqueFd socket) {
  const int fd = socket.get();
  epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
  if (connections_.size() >= kMaxConnections ||
      epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
    return false;
  connections_[fd].socket = std::move(socket);
  return true;
}

bool Server::handle_packet(int fd, const void* data, std::size_t bytes) {
  std::uint32_t kind = 0;
  if (bytes < sizeof kind) return false;
  std::memcpy(&kind, data, sizeof kind);
  if (kind == static_cast<std::uint32_t>(MessageKind::kStatus)) {
    const std::string text = status();
    return send_packet(fd, text.data(), std::min(text.size(), kMaxStatusBytes)).has_value();
  }
  if (kind == static_cast<std::uint32_t>(MessageKind::kHello))
    return welcome(connections_[fd], data, bytes);
  return false;
}

bool Server::welcome(Connection& connection, const void* data, std::size_t bytes) {
  const auto refuse = [&](const char* reason) {
    Refused refused;
    std::strncpy(refused.reason, reason, sizeof refused.reason - 1);
    (void)send_packet(connection.socket.get(), &refused, sizeof refused);
    log::warn("{}: refused a worker: {}", options_.xpu, reason);
    return false;
  };
  Hello hello;
  if (bytes != sizeof hello) return refuse("Hello has another size: use one build of XAuto");
  std::memcpy(&hello, data, sizeof hello);
  if (hello.version != kProtocolVersion) return refuse("another protocol version");
  if (connection.slot >= 0) return refuse("said Hello twice");
  if (std::memchr(hello.worker, 0, sizeof hello.worker) == nullptr)
    return refuse("worker name is not terminated");
  if (hello.num_xnodes > kMaxWorkerXNodes) return refuse("too many XNodes");
  for (std::uint32_t i = 0; i < hello.num_xnodes; ++i)
    if (hello.xnodes[i] >= options_.xnodes.size()) return refuse("names an unknown XNode");
  const auto free =
      std::find_if(slots_.begin(), slots_.end(), [](const SlotInfo& s) { return !s.used; });
  if (free == slots_.end()) return refuse("all worker slots of this XPU are taken");

  const int slot = static_cast<int>(free - slots_.begin());
  SlotMemory& memory = shm_.slots[slot];
  *free = SlotInfo{};
  free->command_fd = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!free->command_fd) return refuse("out of descriptors");
  // The generation goes on where the slot's last user left it, so that an old owner word never
  // matches.
  free->request = request_word(
      Want::kIdle, request_generation(memory.worker.request.load(std::memory_order_seq_cst)));
  memory.worker.request.store(free->request, std::memory_order_seq_cst);
  memory.worker.ack.store(0, std::memory_order_seq_cst);
  memory.coordinator.command.store(0, std::memory_order_seq_cst);
  memory.coordinator.grant.store(kGenerationMask + 1, std::memory_order_seq_cst);  // matches none
  const Welcome answer{.slot = static_cast<std::uint32_t>(slot)};
  if (!send_packet(connection.socket.get(), &answer, sizeof answer,
                   {memory_fd_.get(), doorbell_.get(), free->command_fd.get()}))
    return false;
  free->worker = hello.worker;
  free->xnodes.assign(hello.xnodes, hello.xnodes + hello.num_xnodes);
  free->used = true;
  connection.slot = slot;
  return true;
}

void Server::drop(int fd) {
  const auto found = connections_.find(fd);
  if (found == connections_.end()) return;
  const int slot = found->second.slot;
  epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, fd, nullptr);
  connections_.erase(found);
  if (slot < 0) return;

  // Whatever the dead worker's words say is void: its job is over and nobody waits for it.
  SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
  WorkerLine& line = shm_.slots[slot].worker;
  const std::uint32_t generation = request_generation(line.request.load(std::memory_order_seq_cst));
  info.request = request_word(Want::kIdle, generation);
  line.request.store(info.request, std::memory_order_seq_cst);
  for (const std::uint32_t xnode : info.xnodes)
    if (std::binary_search(tracked_.begin(), tracked_.end(), xnode))
      shm_.finished[xnode].store(UINT64_MAX, std::memory_order_seq_cst);
  std::vector<Action> actions;
  if (arbiter_.slot(slot).phase != Phase::kNone || arbiter_.slot(slot).queue != Queue::kEnabled) {
    log::warn("{}: worker '{}' left with a job of {}", options_.xpu, info.worker,
              xnode_name(arbiter_.slot(slot).job.xnode));
    arbiter_.gone(slot, actions);
  }
  std::uint64_t owner = shm_.header->owner.load(std::memory_order_seq_cst);
  while (owner_slot(owner) == slot &&
         !shm_.header->owner.compare_exchange_weak(owner, owner & kContended)) {
  }
  info.used = false;
  carry_out(actions);
  look();
}

// ---- deciding
// --------------------------------------------------------------------------------------

Job Server::job_of(int slot) const {
  const WorkerLine& line = shm_.slots[slot].worker;
  return {line.xnode.load(std::memory_order_relaxed), line.sequence.load(std::memory_order_relaxed),
          line.priority.load(std::memory_order_relaxed)};
}

/// A request that is neither idle nor the thin owner's: the fast path did not serve it.
bool Server::somebody_waits() const {
  const std::uint64_t owner = shm_.header->owner.load(std::memory_order_seq_cst);
  for (int i = 0; i < kMaxSlots; ++i) {
    if (!slots_[static_cast<std::size_t>(i)].used) continue;
    const std::uint32_t request = shm_.slots[i].worker.request.load(std::memory_order_seq_cst);
    if (request_want(request) != Want::kRun) continue;
    if (owner_slot(owner) == i && owner_generation(owner) == request_generation(request)) continue;
    return true;
  }
  return false;
}

void Server::look() {
  ++looks_;
  std::vector<Action> actions;
  for (;;) {
    if (!fat_) {
      const bool contended = (shm_.header->owner.load(std::memory_order_seq_cst) & kContended) != 0;
      if (!contended && !somebody_waits()) return;
      // A START may be between its request and its CAS; after this exchange the CAS fails and it
      // rings.
      const std::uint64_t thin = shm_.header->owner.exchange(kContended);
      fat_ = true;
      // The thin owner is adopted before anybody else is heard: its job runs.
      const int owner = owner_slot(thin);
      if (owner >= 0 && owner < kMaxSlots) scan_slot(owner, thin, actions);
    }
    scan(actions);
    carry_out(actions);
    actions.clear();
    if (!arbiter_.idle()) return;
    // Nobody is left: hand the owner word back to the fast path. A START that still saw kContended
    // has written its request and rings, or is seen by the next round.
    std::uint64_t expected = kContended;
    shm_.header->owner.compare_exchange_strong(expected, 0);
    fat_ = false;
    if (!somebody_waits()) return;
  }
}

void Server::scan(std::vector<Action>& actions) {
  for (int i = 0; i < kMaxSlots; ++i)
    if (slots_[static_cast<std::size_t>(i)].used) scan_slot(i, 0, actions);
  for (const std::uint32_t xnode : tracked_)
    arbiter_.finished(xnode, shm_.finished[xnode].load(std::memory_order_seq_cst), actions);
}

/// `thin`: the owner word as it was when the coordinator took it over, if this slot is in it; else
/// 0.
void Server::scan_slot(int slot, std::uint64_t thin, std::vector<Action>& actions) {
  SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
  const WorkerLine& line = shm_.slots[slot].worker;

  // Acknowledgements first: a job that follows waits for the queue to be enabled.
  const std::uint32_t ack = line.ack.load(std::memory_order_seq_cst);
  if (ack != info.ack) {
    info.ack = ack;
    const Queue queue = arbiter_.slot(slot).queue;
    if ((ack & ~kAckFailed) == info.command) {  // an answer to anything else is a broken client's
      if (queue == Queue::kSuspending) arbiter_.suspended(slot, (ack & kAckFailed) == 0, actions);
      if (queue == Queue::kResuming) arbiter_.resumed(slot, actions);
    }
  }

  std::uint32_t request = line.request.load(std::memory_order_seq_cst);
  if (request == info.request) return;
  Job job = job_of(slot);
  // The worker may have gone on to its next job while we read; what counts is a consistent pair.
  for (std::uint32_t again; (again = line.request.load(std::memory_order_seq_cst)) != request;
       request = again)
    job = job_of(slot);
  if (job.xnode >= options_.xnodes.size()) job.xnode = 0;  // a broken client hurts only its own job

  if (arbiter_.slot(slot).phase != Phase::kNone) arbiter_.finish(slot, actions);
  info.request = request;
  switch (request_want(request)) {
    case Want::kRun: {
      const bool owns =
          owner_slot(thin) == slot && owner_generation(thin) == request_generation(request);
      if (owns && arbiter_.slot(slot).queue == Queue::kEnabled)
        arbiter_.adopt(slot, job, actions);
      else
        arbiter_.start(slot, job, actions);
      break;
    }
    case Want::kRuns:  // kernel-scheduled: it neither asked nor waits
    case Want::kIdle:
      break;
  }
}

void Server::carry_out(const std::vector<Action>& actions) {
  for (const Action& action : actions) {
    ++decisions_;
    SlotInfo& info = slots_[static_cast<std::size_t>(action.slot)];
    CoordinatorLine& line = shm_.slots[action.slot].coordinator;
    if (!info.used) continue;
    if (action.kind == Action::Kind::kGrant) {
      line.grant.store(request_generation(info.request), std::memory_order_seq_cst);
      futex_wake(line.grant, 1);
      continue;
    }
    const bool suspend = action.kind == Action::Kind::kSuspend;
    info.command = command_word(suspend, (info.command >> 2) + 1);
    line.command.store(info.command, std::memory_order_seq_cst);
    signal_eventfd(info.command_fd.get());
  }
}

// ---- telling
// ---------------------------------------------------------------------------------------

std::string Server::xnode_name(std::uint32_t xnode) const {
  return xnode < options_.xnodes.size() ? options_.xnodes[xnode] : "?";
}

std::string Server::status() const {
  static constexpr const char* kDisciplines[] = {"preemptive", "gate", "kernel"};
  const std::uint64_t owner = shm_.header->owner.load(std::memory_order_seq_cst);
  const auto now = static_cast<std::uint64_t>(now_ns());
  const int top = fat_ ? arbiter_.most_urgent() : -1;
  std::string out =
      "{\"xpu\":" + quoted(options_.xpu) + ",\"pid\":" + std::to_string(getpid()) +
      ",\"discipline\":" + quoted(kDisciplines[static_cast<int>(options_.discipline)]) +
      ",\"mode\":" + quoted(fat_ ? "arbitrated" : "uncontended") +
      ",\"looks\":" + std::to_string(looks_) + ",\"decisions\":" + std::to_string(decisions_) +
      ",\"workers\":[";
  bool first = true;
  for (int i = 0; i < kMaxSlots; ++i) {
    const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
    if (!info.used) continue;
    const std::uint32_t request = shm_.slots[i].worker.request.load(std::memory_order_seq_cst);
    const Arbiter::Slot& slot = arbiter_.slot(i);
    std::string state = "idle", by;
    const bool thin =
        owner_slot(owner) == i && owner_generation(owner) == request_generation(request);
    if (request_want(request) == Want::kRuns || (request_want(request) == Want::kRun && thin)) {
      state = "running";
    } else if (slot.phase == Phase::kWaiting) {
      state = arbiter_.eligible(slot.job) ? "waiting" : "waiting for its order predecessors";
    } else if (slot.phase == Phase::kAdmitted) {
      static constexpr const char* kQueues[] = {"running", "being suspended", "suspended",
                                                "being resumed"};
      state = kQueues[static_cast<int>(slot.queue)];
    } else if (request_want(request) == Want::kRun) {
      state = "starting";
    }
    if (top >= 0 && top != i &&
        (state == "waiting" || state == "suspended" || state == "being suspended"))
      by = xnode_name(arbiter_.slot(top).job.xnode);
    out += first ? "{" : ",{";
    first = false;
    out += "\"worker\":" + quoted(info.worker) + ",\"state\":" + quoted(state);
    if (state != "idle") {
      const Job job = job_of(i);
      const std::uint64_t since = shm_.slots[i].worker.since_ns.load(std::memory_order_relaxed);
      out += ",\"xnode\":" + quoted(xnode_name(job.xnode)) +
             ",\"job\":" + std::to_string(job.sequence) +
             ",\"priority\":" + std::to_string(job.priority) +
             ",\"since_us\":" + std::to_string(now > since ? (now - since) / 1000 : 0);
      if (!by.empty()) out += ",\"by\":" + quoted(by);
    }
    out += "}";
  }
  return out + "]}";
}

}  // namespace xauto::coord
