// SPDX-License-Identifier: Apache-2.0
#include "coord/server.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "base/memory_file.h"
#include "base/socket.h"
#include "coord/core_thread.h"
#include "coord/protocol.h"

namespace xauto::coord {
namespace {

constexpr std::size_t kMaxConnections = 2 * kMaxSlots;
/// Of runs that are not trusted: of one, and of all together.
constexpr int kMaxRunWorkers = 8;
constexpr int kMaxRegulatedWorkers = 16;
/// How long workers of a predecessor may take to come back: they see at once that it is gone.
constexpr int kWorkersReturnMs = 2'000, kWorkersReturnRounds = 10;

}  // namespace

Server::Server(ServerOptions options) : options_(std::move(options)), refusals_(options_.xpu) {}

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
  const auto num_xnodes =
      s.options_.shared ? kMaxSharedXNodes : static_cast<std::uint32_t>(s.options_.xnodes.size());

  s.memory_fd_ = s.options_.memory_fd >= 0
                     ? UniqueFd(s.options_.memory_fd)
                     : private_memfd("xauto-coordinator", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  s.bytes_ = Shm::bytes(num_xnodes);
  struct stat status {};
  if (!s.memory_fd_ || fstat(s.memory_fd_.get(), &status) != 0)
    return fail(ErrorCode::kIo, std::string("cannot make shared memory: ") + strerror(errno));
  const bool fresh = status.st_size == 0;
  if (fresh) XAUTO_TRY(seal_memory(s.memory_fd_.get(), s.bytes_));
  if (!fresh && static_cast<std::size_t>(status.st_size) != s.bytes_)
    return fail(ErrorCode::kInvalid, "the shared memory is another app's");
  void* memory = mmap(nullptr, s.bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE,
                      s.memory_fd_.get(), 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  s.shm_ = Shm::at(memory);
  // A predecessor may have died before it was through with this: then nobody has seen it yet.
  const bool filled = !fresh && s.shm_.header->magic == kShmMagic;
  if (!filled) {
    new (s.shm_.header) Header;
    for (int i = 0; i < kMaxSlots; ++i) new (s.shm_.slots + i) SlotMemory;
    for (std::uint32_t i = 0; i < num_xnodes; ++i)
      new (s.shm_.finished + i) std::atomic<std::uint64_t>(0);
    s.shm_.header->version = kShmVersion;
    s.shm_.header->num_xnodes = num_xnodes;
    s.shm_.header->discipline = static_cast<std::uint8_t>(s.options_.discipline);
    s.shm_.header->levels = static_cast<std::uint32_t>(std::max(0, s.options_.levels));
    std::atomic_thread_fence(std::memory_order_release);
    s.shm_.header->magic = kShmMagic;
  } else if (s.shm_.header->version != kShmVersion || s.shm_.header->num_xnodes != num_xnodes ||
             s.shm_.header->discipline != static_cast<std::uint8_t>(s.options_.discipline)) {
    return fail(ErrorCode::kInvalid, "the shared memory is another app's");
  }
  s.record_fd_ = UniqueFd(s.options_.record_fd);
  if (s.options_.shared) {
    XAUTO_ASSIGN(s.record_, Record::map(s.record_fd_.get(), true));
  }
  s.referee_.emplace(s.shm_, s.options_.discipline, s.options_.order, s.options_.levels);
  if (filled && s.shm_.header->order == OrderKept::kNotKept) s.referee_->forget_order();

  s.doorbell_ = UniqueFd(s.options_.doorbell_fd >= 0 ? s.options_.doorbell_fd
                                                     : eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  s.epoll_ = UniqueFd(epoll_create1(EPOLL_CLOEXEC));
  s.alarm_ = UniqueFd(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK));
  if (!s.doorbell_ || !s.epoll_ || !s.alarm_)
    return fail(ErrorCode::kIo, std::string("eventfd/epoll: ") + strerror(errno));
  s.listener_ = UniqueFd(s.options_.listener_fd);
  if (!s.listener_ && s.options_.shared)
    return fail(ErrorCode::kInvalid, "a shared coordinator needs a socket to the service");
  if (!s.listener_) {
    XAUTO_ASSIGN(s.listener_, listen_abstract(s.options_.address));
  }
  for (const int fd : {s.doorbell_.get(), s.listener_.get(), s.alarm_.get()}) {
    epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
    if (epoll_ctl(s.epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
      return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  }
  if (filled) s.take_over_from_predecessor();
  s.referee_->give_away();  // the thread that runs it may be another one
  return server;
}

void Server::take_over_from_predecessor() {
  Wakes wakes;
  referee_->rebuild(wakes);
  wake(wakes);
  int absent = 0;
  for (int i = 0; i < kMaxSlots; ++i)
    if (referee_->used(i)) {
      slots_[static_cast<std::size_t>(i)].absent = true;
      ++absent;
    }
  if (absent > 0) {
    absent_until_ns_ = now_ns() + std::int64_t{kWorkersReturnMs} * 1'000'000;
    absent_rounds_ = kWorkersReturnRounds;
  }
  log::info("{}: took over from a coordinator that died: {} workers", options_.xpu, absent);
}

/// Workers of our predecessor that have not come back: they died meanwhile.
void Server::give_up_absent() {
  absent_until_ns_ = 0;
  for (int i = 0; i < kMaxSlots; ++i)
    if (slots_[static_cast<std::size_t>(i)].absent) leave(i);
}

Status Server::run(int stop_fd) {
  thread_.check();
  epoll_event stop{.events = EPOLLIN, .data = {.fd = stop_fd}};
  if (epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, stop_fd, &stop) != 0)
    return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  std::array<epoll_event, 32> events;
  for (;;) {
    // Announce the sleep, then look once more: a ring before the announcement is seen by this look,
    // a ring after it writes the eventfd.
    shm_.header->waiting.store(1, std::memory_order_seq_cst);
    for (auto& [lease, page] : pages_)
      page.shm().header->waiting.store(1, std::memory_order_seq_cst);
    look();
    set_alarm();
    int timeout_ms = -1;
    if (absent_until_ns_ != 0) {
      // Rounds as well as time: on a machine that stood still, whoever is back is heard first.
      if (absent_rounds_ > 0) --absent_rounds_;
      if (absent_rounds_ == 0 && now_ns() >= absent_until_ns_) give_up_absent();
      timeout_ms = kWorkersReturnMs / kWorkersReturnRounds;
    }
    const int count =
        epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), timeout_ms);
    shm_.header->waiting.store(0, std::memory_order_seq_cst);
    for (auto& [lease, page] : pages_)
      page.shm().header->waiting.store(0, std::memory_order_seq_cst);
    if (count < 0 && errno != EINTR)
      return fail(ErrorCode::kIo, std::string("epoll_wait: ") + strerror(errno));
    for (int i = 0; i < count; ++i) {
      const int fd = events[static_cast<std::size_t>(i)].data.fd;
      if (fd == stop_fd) return {};
      const auto page = std::ranges::find(
          pages_, fd, [](const auto& entry) { return entry.second.doorbell_fd(); });
      if (fd == doorbell_.get() || fd == alarm_.get()) {
        drain_eventfd(fd);
        if (fd == alarm_.get()) alarm_ns_ = 0;
      } else if (page != pages_.end()) {
        hear_doorbell(page->second);
      } else if (fd == listener_.get()) {
        if (!options_.shared)
          accept_connection();
        else if (!hear_service())
          return fail(ErrorCode::kUnavailable, "the machine's service is gone");
      } else {
        Hello packet;
        const auto size = receive_packet(fd, &packet, sizeof packet);
        if (!size || !handle_packet(fd, &packet, *size)) drop(fd);
      }
    }
  }
}

// ---- joining and leaving ------------------------------------------------------------------------

void Server::accept_connection() {
  auto peer = accept_own(listener_.get());
  if (!peer) {
    refusals_.tell(peer.error().what, now_ns());
    return;
  }
  if (!adopt_connection(std::move(*peer)))
    refusals_.tell("refused a connection: " + std::to_string(connections_.size()) + " are open",
                   now_ns());
}

/// False: it is gone.
bool Server::hear_service() {
  Regulate all;  // the longer one
  std::vector<UniqueFd> fds;
  const auto size = receive_packet(listener_.get(), &all, sizeof all, &fds);
  if (!size) return size.error().code != ErrorCode::kUnavailable;
  if (*size == sizeof all && all.kind == static_cast<std::uint32_t>(MessageKind::kRegulate)) {
    if (const Status done = regulate(all); !done)
      log::warn("{}: {}", options_.xpu, done.error().what);
    return true;
  }
  Adopt packet;
  if (*size != sizeof packet) return true;
  std::memcpy(&packet, static_cast<const void*>(&all), sizeof packet);
  if (packet.kind == static_cast<std::uint32_t>(MessageKind::kEndLease)) {
    end_lease(packet.lease);
  } else if (packet.kind == static_cast<std::uint32_t>(MessageKind::kAdopt) && fds.size() == 1) {
    if (packet.regulated != 0 && !pages_.contains(packet.lease)) return true;
    if (!adopt_connection(std::move(fds[0]), packet))
      refusals_.tell("refused a connection: " + std::to_string(connections_.size()) + " are open",
                     now_ns());
  }
  return true;
}

void Server::end_lease(std::uint32_t lease) {
  thread_.check();
  std::vector<int> theirs;
  for (const auto& [fd, connection] : connections_)
    if (connection.whose.lease == lease) theirs.push_back(fd);
  for (const int fd : theirs) drop(fd);
  const auto page = pages_.find(lease);
  if (page == pages_.end()) return;
  for (const std::uint32_t xnode : page->second.xnodes()) referee_->forget(xnode);
  epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, page->second.doorbell_fd(), nullptr);
  pages_.erase(page);
}

Status Server::regulate(const Regulate& run) {
  thread_.check();
  if (run.num_tasks == 0 || run.num_tasks > kMaxRegulated || pages_.contains(run.lease))
    return fail(ErrorCode::kInvalid, "says twice, or too much of, what a run may have");
  for (std::uint32_t i = 0; i < run.num_tasks; ++i)
    if (!run.tasks[i].makes_sense() || referee_->is_regulated(run.tasks[i].xnode))
      return fail(ErrorCode::kInvalid, "says of an XNode what cannot be");
  XAUTO_ASSIGN(RunPage page, RunPage::make(run, options_.discipline));
  epoll_event event{.events = EPOLLIN, .data = {.fd = page.doorbell_fd()}};
  if (epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, page.doorbell_fd(), &event) != 0)
    return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  for (std::uint32_t i = 0; i < run.num_tasks; ++i) referee_->regulate(run.tasks[i]);
  pages_.emplace(run.lease, std::move(page));
  return {};
}

/// Who rings more often than his jobs need is not heard for a while.
void Server::hear_doorbell(RunPage& page) {
  drain_eventfd(page.doorbell_fd());
  const std::int64_t now = now_ns(), heard = page.rung(now);
  if (heard <= now) return;
  page.deaf_until_ns = heard;
  epoll_event none{.events = 0, .data = {.fd = page.doorbell_fd()}};
  epoll_ctl(epoll_.get(), EPOLL_CTL_MOD, page.doorbell_fd(), &none);
}

/// When there is something to do that nobody rings for: a budget ends, a turn comes, a doorbell is heard again.
void Server::set_alarm() {
  const std::int64_t now = now_ns();
  std::int64_t next = referee_->next_look_ns();
  for (auto& [lease, page] : pages_) {
    if (page.deaf_until_ns == 0) continue;
    if (page.deaf_until_ns > now) {
      next = next == 0 ? page.deaf_until_ns : std::min(next, page.deaf_until_ns);
      continue;
    }
    page.deaf_until_ns = 0;
    epoll_event event{.events = EPOLLIN, .data = {.fd = page.doorbell_fd()}};
    epoll_ctl(epoll_.get(), EPOLL_CTL_MOD, page.doorbell_fd(), &event);
  }
  if (next == alarm_ns_) return;
  alarm_ns_ = next;
  itimerspec at{};  // 0: never
  at.it_value = {next / 1'000'000'000, next % 1'000'000'000};
  timerfd_settime(alarm_.get(), TFD_TIMER_ABSTIME, &at, nullptr);
}

bool Server::may_name(const Connection& connection, std::uint32_t xnode) const {
  if (!options_.shared) return xnode < options_.xnodes.size();
  return xnode >= connection.whose.first_xnode &&
         xnode - connection.whose.first_xnode < connection.whose.num_xnodes &&
         xnode < kMaxSharedXNodes;
}

bool Server::adopt_connection(UniqueFd socket, const Adopt& whose) {
  const int fd = socket.get();
  epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
  if (connections_.size() >= kMaxConnections ||
      epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
    return false;
  connections_[fd] = Connection{.socket = std::move(socket), .whose = whose};
  return true;
}

bool Server::handle_packet(int fd, const void* data, std::size_t bytes) {
  thread_.check();
  std::uint32_t kind = 0;
  if (bytes < sizeof kind) return false;
  std::memcpy(&kind, data, sizeof kind);
  // What is answered below is not for everybody, and takes time that others wait for.
  if (connections_[fd].whose.regulated != 0 &&
      kind != static_cast<std::uint32_t>(MessageKind::kHello))
    return false;
  if (kind == static_cast<std::uint32_t>(MessageKind::kStatus)) {
    look();  // whoever took the XPU has not told us
    const std::string text = to_json(status()).dump();
    return send_packet(fd, text.data(), std::min(text.size(), kMaxStatusBytes)).has_value();
  }
  if (kind == static_cast<std::uint32_t>(MessageKind::kObserve)) {
    const Welcome answer{.slot = kMaxSlots};
    return send_packet(fd, &answer, sizeof answer, {memory_fd_.get()}).has_value();
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
    refusals_.tell(std::string("refused a worker: ") + reason, now_ns());
    return false;
  };
  Hello hello;
  if (bytes != sizeof hello) return refuse("Hello has another size: use one build of XAuto");
  std::memcpy(&hello, data, sizeof hello);
  if (const char* fault = fault_of(connection, hello)) return refuse(fault);
  const auto page = pages_.find(connection.whose.lease);
  int slot = 0;
  const bool rejoins = hello.rejoin != 0;
  if (rejoins) {
    slot = static_cast<int>(hello.rejoin) - 1;
    if (hello.rejoin > kMaxSlots || !slots_[static_cast<std::size_t>(slot)].absent)
      return refuse("comes back to a slot that is not its own");
  } else {
    while (slot < kMaxSlots && referee_->used(slot)) ++slot;
    if (slot == kMaxSlots) return refuse("all worker slots of this XPU are taken");
  }
  SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
  info = SlotInfo{};
  info.worker = hello.worker;
  info.xnodes.assign(hello.xnodes, hello.xnodes + hello.num_xnodes);
  if (connection.whose.regulated != 0) {
    if (page == pages_.end() || !welcome_regulated(connection, page->second, slot))
      return refuse("has no process, or too many workers here");
    if (record_) record_.slot(slot).give(connection.whose.lease);
    return true;
  }
  if (!rejoins) referee_->join(slot);
  connection.slot = slot;
  std::vector<int> fds = {memory_fd_.get(), doorbell_.get()};
  if (record_) fds.push_back(record_fd_.get());
  if (record_ && !rejoins) record_.slot(slot).give(connection.whose.lease);
  const Welcome answer{.slot = static_cast<std::uint32_t>(slot)};
  return send_packet(connection.socket.get(), &answer, sizeof answer, fds).has_value();
}

/// nullptr: there is none.
const char* Server::fault_of(const Connection& connection, const Hello& hello) {
  if (hello.version != kProtocolVersion) return "another protocol version";
  if (connection.slot >= 0) return "said Hello twice";
  if (std::memchr(hello.worker, 0, sizeof hello.worker) == nullptr)
    return "worker name is not terminated";
  if (hello.num_xnodes > kMaxWorkerXNodes) return "too many XNodes";
  for (std::uint32_t i = 0; i < hello.num_xnodes; ++i)
    if (!may_name(connection, hello.xnodes[i])) return "names an unknown XNode";
  if (!agree_on_order(hello.num_order)) return "keeps other order constraints than we do";
  return nullptr;
}

/// False: he may not.
bool Server::welcome_regulated(Connection& connection, RunPage& page, int slot) {
  int all = 0;
  for (const auto& [lease, other] : pages_) all += other.workers;
  const auto peer = peer_of(connection.socket.get());
  if (!peer || peer->pid <= 0 || page.workers >= kMaxRunWorkers || all >= kMaxRegulatedWorkers)
    return false;
  if (const Status limited = page.hostile() ? limit_raised(peer->pid) : Status(); !limited)
    refusals_.tell(
        "if this coordinator and its service are killed, nothing ends a thread of process " +
            std::to_string(peer->pid) + " that has a core: " + limited.error().what,
        now_ns());
  SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
  info.page = &page;
  info.process = peer->pid;
  info.lives = process_behind(connection.socket.get(), peer->pid);
  ++page.workers;
  connection.slot = slot;
  referee_->join_regulated(slot, page.shm().slots);
  const Welcome answer{.slot = static_cast<std::uint32_t>(slot)};
  return send_packet(connection.socket.get(), &answer, sizeof answer,
                     {page.memory_fd(), page.doorbell_fd()})
      .has_value();
}

/// In their order: who has lost the core is off it before another one is on.
void Server::lay_hands(const std::vector<Hand>& hands) {
  const int core = core_number(options_.xpu);
  for (const Hand& hand : hands) {
    SlotInfo& info = slots_[static_cast<std::size_t>(hand.slot)];
    if (info.page == nullptr) continue;
    record(hand);
    if (core < 0) continue;
    const bool hostile = info.page->hostile(), gives = hand.kind == Hand::Kind::kGive;
    const pid_t named = std::exchange(
        info.named,
        gives ? static_cast<pid_t>(info.page->shm().slots[hand.slot].coordinator.thread.load())
              : info.named);
    // A number may be another's by now: whoever has threads end can know of which.
    if (hostile || info.named != named || info.thread == 0)
      info.thread = lives(info.lives.get()) ? thread_of(info.process, info.named) : 0;
    if (gives) {
      if (info.thread != 0) (void)give_core(info.thread, core);
    } else if (info.thread != 0 && hand.kind == Hand::Kind::kOver && !hostile) {
      let_ask(info.thread);
    } else if (info.thread != 0) {
      take_core(info.thread, hostile);
    }
  }
}

/// For how long it has had the XPU: by our clock, for what it says itself is not believed.
void Server::record(const Hand& hand) {
  SlotInfo& info = slots_[static_cast<std::size_t>(hand.slot)];
  const std::int64_t now = now_ns();
  const std::int64_t since =
      std::exchange(info.given_ns, hand.kind == Hand::Kind::kGive ? now : std::int64_t{0});
  if (since != 0 && record_) record_.slot(hand.slot).add(since, now, now - since);
}

/// What one side keeps and the other does not would leave a job waiting for ever, so whether order
/// is kept is said once, by the first worker, and outlives us.
bool Server::agree_on_order(std::uint32_t num_order) {
  OrderKept& kept = shm_.header->order;
  if (kept == OrderKept::kUnknown) {
    kept = num_order == 0 ? OrderKept::kNotKept : OrderKept::kKept;
    if (num_order == 0) referee_->forget_order();
  }
  return num_order == (kept == OrderKept::kKept ? options_.order.size() : 0);
}

void Server::drop(int fd) {
  const auto found = connections_.find(fd);
  if (found == connections_.end()) return;
  const int slot = found->second.slot;
  epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, fd, nullptr);
  connections_.erase(found);
  if (slot >= 0) leave(slot);
}

/// Its job is over and nobody waits for it.
void Server::leave(int slot) {
  SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
  const Arbiter::Slot& state = referee_->arbiter().slot(slot);
  if (referee_->fat() && (state.phase != Phase::kNone || state.queue != Queue::kEnabled))
    log::warn("{}: worker '{}' left with a job of {}", options_.xpu, info.worker,
              xnode_name(state.job.xnode));
  info.absent = false;
  Wakes wakes;
  referee_->at(now_ns());
  referee_->leave(slot, info.xnodes, wakes);
  wake(wakes);
  if (record_) record_.slot(slot).give(0);
  if (info.page == nullptr) return;
  --info.page->workers;
  info = SlotInfo{};
}

// ---- deciding -----------------------------------------------------------------------------------

void Server::look() {
  thread_.check();
  ++looks_;
  Wakes wakes;
  if (!pages_.empty()) referee_->at(now_ns());
  referee_->look(wakes);
  wake(wakes);
}

void Server::wake(const Wakes& wakes) {
  lay_hands(wakes.hands);
  if (wakes.again) signal_eventfd(doorbell_.get());
  for (const int slot : wakes.granted) {
    const RunPage* page = slots_[static_cast<std::size_t>(slot)].page;
    futex_wake((page != nullptr ? page->shm() : shm_).slots[slot].coordinator.grant, 1);
  }
  for (const int slot : wakes.commanded) futex_advance(shm_.slots[slot].coordinator.bell, 1);
}

// ---- telling ------------------------------------------------------------------------------------

namespace {
bool names(std::uint64_t word, int slot, std::uint32_t generation) {
  return owner_slot(word) == slot && owner_generation(word) == generation;
}
}  // namespace

std::string Server::xnode_name(std::uint32_t xnode) const {
  if (options_.shared) return "XNode " + std::to_string(xnode);
  return xnode < options_.xnodes.size() ? options_.xnodes[xnode] : "?";
}

/// On levels: whether the job of this slot was started, and others above it, as the chain of words says.
bool Server::started_below(std::uint64_t word, int index, std::uint32_t generation) const {
  if (options_.discipline != Discipline::kLevels) return false;
  for (int steps = 0; (word & kTaken) != 0 && steps < kMaxSlots; ++steps) {
    if (owner_slot(word) < 0 || owner_slot(word) >= kMaxSlots) return false;
    word = shm_.slots[owner_slot(word)].worker.victim.load(std::memory_order_seq_cst);
    if (names(word, index, generation)) return true;
  }
  return false;
}

/// What the worker of this slot is doing, in words; `fat`: the coordinator decides.
std::string Server::state_of(int index, bool fat) const {
  const SlotMemory& memory = referee_->memory(index);
  const std::uint64_t owner = shm_.header->owner.load(std::memory_order_seq_cst);
  const std::uint32_t request = memory.worker.request.load(std::memory_order_seq_cst);
  const Want want = request_want(request);
  // A fat word still names who had the XPU last; whether that job runs is the arbiter's to say.
  const std::uint32_t generation = request_generation(request);
  const bool owns =
      !fat && (names(owner, index, generation) || started_below(owner, index, generation));
  const bool granted =
      options_.discipline == Discipline::kKernel && memory.coordinator.grant.load() == generation;
  if (want == Want::kRuns || (want == Want::kRun && (owns || granted))) return "running";
  const auto waits = [&] {
    const Job job = referee_->job_of(index);
    return referee_->arbiter().order().eligible(
               job.xnode, job.sequence, [&](std::uint32_t u) { return shm_.finished[u].load(); })
               ? "waiting"
               : "waiting for its order predecessors";
  };
  if (!fat) {
    if (want != Want::kRun) return "idle";
    return (memory.coordinator.command.load() & 1u) != 0 ? "suspended" : waits();
  }
  const Arbiter::Slot& slot = referee_->arbiter().slot(index);
  if (slot.phase == Phase::kWaiting) return waits();
  if (slot.phase == Phase::kAdmitted) {
    static constexpr const char* kQueues[] = {"running", "being suspended", "suspended",
                                              "being resumed"};
    return kQueues[static_cast<int>(slot.queue)];
  }
  return want == Want::kRun ? "starting" : "idle";
}

/// The slot for whose job others wait; -1: nobody's.
int Server::waited_for(bool fat) const {
  if (fat) return referee_->arbiter().most_urgent();
  const int owner = owner_slot(shm_.header->owner.load(std::memory_order_seq_cst));
  return owner < kMaxSlots ? owner : -1;  // as a worker may have written it
}

XpuStatus Server::status() const {
  const auto now = static_cast<std::uint64_t>(now_ns());
  const bool fat = referee_->fat();
  const int first = waited_for(fat);
  XpuStatus status{.xpu = options_.xpu,
                   .pid = getpid(),
                   .discipline = options_.discipline,
                   .arbitrated = fat,
                   .looks = looks_,
                   .decisions = referee_->decisions(),
                   .workers = {}};
  for (int i = 0; i < kMaxSlots; ++i) {
    if (!referee_->used(i)) continue;
    WorkerStatus worker;
    worker.worker = slots_[static_cast<std::size_t>(i)].worker;
    worker.state = state_of(i, fat);
    if (!worker.idle()) {
      const Job job = referee_->job_of(i);
      worker.xnode = xnode_name(job.xnode);
      worker.job = job.sequence;
      if (options_.by_keys)
        worker.due_us = job.key / 1000 - static_cast<std::int64_t>(now / 1000);
      else
        worker.priority = priority_of_key(job.key);
      worker.since_us = now > job.since_ns ? (now - job.since_ns) / 1000 : 0;
      if (first >= 0 && first != i &&
          (worker.state == "waiting" || worker.state == "suspended" ||
           worker.state == "being suspended"))
        worker.by = xnode_name(referee_->job_of(first).xnode);
    }
    status.workers.push_back(std::move(worker));
  }
  return status;
}

}  // namespace xauto::coord
