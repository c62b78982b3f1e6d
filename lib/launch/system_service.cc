// SPDX-License-Identifier: Apache-2.0
#include "launch/system_service.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <map>
#include <utility>

#include <fcntl.h>
#include <sys/random.h>
#include <sys/socket.h>

#include "base/clock.h"
#include "base/core_levels.h"
#include "base/memory_file.h"
#include "base/rt.h"
#include "base/socket.h"
#include "coord/core_thread.h"
#include "coord/shm_layout.h"
#include "model/json.h"
#include "model/json_value.h"

namespace xauto::launch {
namespace {

constexpr std::size_t kMaxGuests = 256;
constexpr std::size_t kMaxGuestsOfUser = 192;
constexpr std::size_t kMaxLeases = 64;
constexpr std::ptrdiff_t kMaxRegulatedRuns = 4;
constexpr std::int64_t kGuestNs =
    2'000'000'000;  ///< between two packets of one that has not said all
constexpr std::size_t kMaxRunProcesses = 64;
constexpr int kServiceLookMs = 200;
constexpr std::int64_t kMomentNs = 200'000'000;
/// A test that takes longer is not made only to tell somebody a number.
constexpr std::int64_t kSlackNs = 20'000'000;
constexpr std::size_t kMostShown = 64;  ///< XPUs whose records go with one answer

template <std::size_t Bytes>
bool ends(const char (&text)[Bytes]) {
  return text[0] != '\0' && std::memchr(text, '\0', Bytes) != nullptr;
}

void refuse_worker(int socket, const std::string& why) {
  coord::Refused refused;
  std::strncpy(refused.reason, why.c_str(), sizeof refused.reason - 1);
  (void)send_packet(socket, &refused, sizeof refused);
}

/// What a run asks of the machine, its XPUs called as they are here.
Result<Demand> demand_here(const Join& join, const std::string& text) {
  XAUTO_ASSIGN(Demand demand, parse_demand(text, std::string("app '") + join.app + "'"));
  std::map<std::string, std::string> hardware;
  for (std::uint32_t i = 0; i < join.num_xpus; ++i)
    hardware[join.xpus[i].id] = join.xpus[i].hardware;
  std::erase_if(demand.xpus, [&](const DemandOnXpu& on) {
    return !hardware.contains(on.xpu.id);  // emulated, or the kernel's
  });
  if (demand.xpus.size() != join.num_xpus)
    return fail(ErrorCode::kInvalid, "its demand leaves out an XPU that it asks for");
  for (DemandOnXpu& on : demand.xpus) on.xpu.id = hardware.at(on.xpu.id);
  XAUTO_TRY(validate(demand));
  return demand;
}

bool has(const Demand& demand, const std::string& hardware) {
  return std::any_of(demand.xpus.begin(), demand.xpus.end(),
                     [&](const DemandOnXpu& on) { return on.xpu.id == hardware; });
}

/// "core0: why", as it is told to a run.
std::string words_of(const Error& error) {
  return error.where.empty() ? error.what : error.where + ": " + error.what;
}

void refuse_run(int socket, const Error& why, bool later) {
  NotAdmitted answer{.later = later ? 1u : 0u};
  std::strncpy(answer.reason, words_of(why).c_str(), sizeof answer.reason - 1);
  (void)send_packet(socket, &answer, sizeof answer);
}

std::string of_uid(uid_t uid) {
  return " of uid " + std::to_string(uid);
}

}  // namespace

SystemService::SystemService(SystemOptions options)
    : options_(std::move(options)), daemons_(options_.bin, notes_), refusals_("system") {}

SystemService::~SystemService() {
  for (auto& [hardware, shared] : shared_) shared.foreign.reset();
  daemons_.stop(kGraceMs);
  for (const auto& [number, lease] : leases_)
    if (lease.regulated())
      for (const RunProcess& process : lease.processes) process.lower();
}

void SystemService::run(int stop_fd) {
  thread_.check();
  const int listener = options_.listener.get();
  fcntl(listener, F_SETFL, fcntl(listener, F_GETFL) | O_NONBLOCK);  // systemd's may wait
  for (;;) {
    std::vector<pollfd> fds = {{stop_fd, POLLIN, 0}, {options_.listener.get(), POLLIN, 0}};
    for (const auto& [fd, guest] : guests_) fds.push_back({fd, POLLIN, 0});
    for (const auto& [number, lease] : leases_) fds.push_back({lease.socket.get(), POLLIN, 0});
    const std::size_t clients = fds.size();
    daemons_.add_to(fds);
    poll(fds.data(), fds.size(), kServiceLookMs);
    if (fds[0].revents != 0) return;
    if (fds[1].revents != 0) accept_guests();
    for (std::size_t i = 2; i < clients; ++i)
      if (fds[i].revents != 0) (void)hear(fds[i].fd);
    close_late_guests(now_ns());
    forget_departed();
    (void)daemons_.look_after(now_ns());
    // It knew whose turn it was, and whom it had raised.
    if (std::exchange(deaths_, daemons_.deaths()) != deaths_) end_regulated();
  }
}

// ---- who connects -------------------------------------------------------------------------------

void SystemService::accept_guests() {
  for (;;) {
    UniqueFd socket(accept4(options_.listener.get(), nullptr, nullptr, SOCK_CLOEXEC));
    if (!socket) return;
    const auto who = peer_of(socket.get());
    if (who) (void)adopt(std::move(socket), who->uid);
  }
}

int SystemService::adopt(UniqueFd socket, uid_t uid) {
  thread_.check();
  const auto same = [&](const auto& entry) { return entry.second.uid == uid; };
  const auto mine = static_cast<std::size_t>(std::count_if(guests_.begin(), guests_.end(), same));
  if (guests_.size() >= kMaxGuests || mine >= kMaxGuestsOfUser) {
    refusals_.tell("refused a connection" + of_uid(uid) + ": " + std::to_string(mine) +
                       " of that user have not said yet what they want",
                   now_ns());
    return -1;
  }
  const int fd = socket.get();
  Guest& guest = guests_[fd];
  guest = Guest{.socket = std::move(socket), .uid = uid, .join = {}, .demand = {}};
  guest.until_ns = now_ns() + kGuestNs;
  return fd;
}

void SystemService::close_late_guests(std::int64_t now) {
  std::erase_if(guests_, [&](const auto& entry) { return now > entry.second.until_ns; });
}

bool SystemService::hear(int fd) {
  thread_.check();
  if (const auto guest = guests_.find(fd); guest != guests_.end()) {
    if (hear_guest(guest->second)) return true;
    guests_.erase(fd);
    return false;
  }
  for (const auto& [number, lease] : leases_) {
    if (lease.socket.get() != fd) continue;
    end(number);  // whatever it says: there is nothing more to be said
    return false;
  }
  return false;
}

/// False: it has no more to do with us.
bool SystemService::hear_guest(Guest& guest) {
  std::string packet(std::max({kDemandPiece, sizeof(Join), sizeof(coord::Attach)}), '\0');
  const int fd = guest.socket.get();
  const auto size = receive_packet(fd, packet.data(), packet.size());
  if (!size) return false;
  packet.resize(*size);
  guest.until_ns = now_ns() + kGuestNs;
  if (guest.join) return take_piece(guest, packet);
  std::uint32_t kind = 0;
  if (packet.size() < sizeof kind) return false;
  std::memcpy(&kind, packet.data(), sizeof kind);
  if (kind == static_cast<std::uint32_t>(coord::MessageKind::kStatus)) {
    const std::string text = status(guest.uid);
    (void)send_packet(fd, text.data(), text.size());
    return false;
  }
  if (kind == static_cast<std::uint32_t>(SystemWord::kWatch)) {
    show_records(fd, guest.uid);
    return false;
  }
  if (kind == static_cast<std::uint32_t>(coord::MessageKind::kAttach) &&
      packet.size() == sizeof(coord::Attach)) {
    coord::Attach attach;
    std::memcpy(&attach, packet.data(), sizeof attach);
    hand_on(std::move(guest.socket), guest.uid, attach);
    return false;
  }
  if (kind != static_cast<std::uint32_t>(SystemWord::kJoin) || packet.size() != sizeof(Join))
    return false;
  std::memcpy(&guest.join.emplace(), packet.data(), sizeof(Join));
  const Status fault = fault_of(*guest.join, guest.uid);
  if (!fault) refuse_run(fd, fault.error(), false);
  return fault.has_value();
}

// ---- a run joins and leaves ---------------------------------------------------------------------

Status SystemService::fault_of(const Join& join, uid_t uid) const {
  if (join.version != kSystemVersion)
    return fail(ErrorCode::kInvalid, "speaks version " + std::to_string(join.version) +
                                         ", the machine's service version " +
                                         std::to_string(kSystemVersion) + ": use one build");
  const bool bounded = join.num_xnodes > 0 && join.num_xnodes <= coord::kMaxSharedXNodes &&
                       join.num_xpus > 0 && join.num_xpus <= kMaxLeaseXpus &&
                       join.demand_bytes > 0 && join.demand_bytes <= kMaxDemandBytes;
  if (!bounded || !ends(join.app) || !fault_of_name(join.app).empty())
    return fail(ErrorCode::kInvalid, "asks for more than a run can, or has no name");
  for (std::uint32_t i = 0; i < join.num_xpus; ++i) {
    const JoinXpu& xpu = join.xpus[i];
    if (!ends(xpu.id) || !ends(xpu.hardware) || !fault_of_name(xpu.hardware).empty() ||
        std::strchr(xpu.hardware, '/') != nullptr ||
        xpu.discipline > static_cast<std::uint32_t>(Discipline::kLevels))
      return fail(ErrorCode::kInvalid, "names an XPU that can be none");
    if (xpu.discipline == static_cast<std::uint32_t>(Discipline::kKernel))
      return fail(ErrorCode::kInvalid, "wants an XPU that the kernel schedules to be shared");
  }
  if (leases_.size() + departed_.size() >= kMaxLeases)
    return fail(ErrorCode::kUnavailable, "as many runs as can be are there");
  return fault_of_tasks(join, uid);
}

/// Of a run that is not trusted.
Status SystemService::fault_of_tasks(const Join& join, uid_t uid) const {
  const bool regulated = !options_.trust.trusts(uid);
  if (regulated != (join.num_tasks > 0))
    return fail(ErrorCode::kInvalid,
                regulated ? "is not trusted here, and does not say what each XNode needs"
                          : "is trusted here, and says what only others do");
  if (!regulated) return {};
  if (join.num_tasks > coord::kMaxRegulated || join.num_xnodes > coord::kMaxRegulated ||
      join.demand_bytes != join.num_tasks * sizeof(LeaseTask))
    return fail(ErrorCode::kInvalid, "is not trusted here, and has more than " +
                                         std::to_string(coord::kMaxRegulated) + " XNodes");
  const auto others = [&](const auto& entry) {
    return entry.second.regulated() && is_stranger(entry.second.uid) && entry.second.uid != uid;
  };
  // A thread that has a core may go to another one: what it takes there nobody of its own user has.
  if (is_stranger(uid) && std::any_of(leases_.begin(), leases_.end(), others))
    return fail(ErrorCode::kUnavailable, "another user who is not trusted is there");
  if (std::ranges::count_if(leases_, [](const auto& entry) { return entry.second.regulated(); }) >=
      kMaxRegulatedRuns)
    return fail(ErrorCode::kUnavailable, "as many runs that are not trusted as can be are there");
  if (is_stranger(uid) ? !coord::may_give_cores() : rt::highest_fifo() < kCpuAsks)
    return fail(ErrorCode::kPermission,
                "the machine's service may not set how other users' threads are scheduled");
  return {};
}

/// False: it has no more to do with us, or is a lease by now.
bool SystemService::take_piece(Guest& guest, const std::string& piece) {
  guest.demand += piece;
  if (guest.demand.size() < guest.join->demand_bytes) return piece.size() == kDemandPiece;
  if (guest.demand.size() > guest.join->demand_bytes) return false;
  bool later = false;
  const auto number = admit(guest, later);
  if (!number) {
    refuse_run(guest.socket.get(), number.error(), later);
    if (!later)
      log::info("app '{}'{} was not admitted: {}", guest.join->app, of_uid(guest.uid),
                words_of(number.error()));
    return false;
  }
  Leased& lease = leases_.at(*number);
  const Admitted answer{.lease = *number,
                        .secret = lease.secret,
                        .first_xnode = lease.first_xnode,
                        .num_xnodes = lease.num_xnodes};
  lease.socket = std::move(guest.socket);
  log::info("app '{}'{} was admitted", lease.app, of_uid(lease.uid));
  if (!send_packet(lease.socket.get(), &answer, sizeof answer)) end(*number);
  return false;
}

/// `later`: it is refused for what those have not given back yet that have left.
Result<std::uint32_t> SystemService::admit(Guest& guest, bool& later) {
  const Join& join = *guest.join;
  Leased lease{.uid = guest.uid, .num_xnodes = join.num_xnodes, .app = join.app, .demand = {}};
  if (join.num_tasks > 0) {
    lease.tasks.resize(join.num_tasks);
    std::memcpy(static_cast<void*>(lease.tasks.data()), guest.demand.data(), guest.demand.size());
    XAUTO_ASSIGN(lease.demand, demand_of_tasks(join, lease.tasks));
  } else {
    XAUTO_ASSIGN(lease.demand, demand_here(join, guest.demand));
  }
  for (std::uint32_t i = 0; i < join.num_xpus; ++i)
    if (may_suspend_foreign(join.xpus[i])) lease.beside_foreign.insert(join.xpus[i].hardware);
  Status fits = test(lease, true, false);
  if (!fits && !lease.regulated() && test(lease, false, false)) {
    // Who is trusted finds the machine as if nobody else were there.
    end_regulated();
    fits = test(lease, true, false);
  }
  if (!fits) return tl::unexpected<Error>(std::move(fits).error());
  forget_departed();
  if (!departed_.empty()) {
    Status still = test(lease, true, true);
    later = !still.has_value();
    if (later) return tl::unexpected<Error>(std::move(still).error());
  }
  if (getrandom(&lease.secret, sizeof lease.secret, 0) != sizeof lease.secret)
    return fail(ErrorCode::kIo, std::string("getrandom: ") + strerror(errno));
  Status shared = share(join);
  const auto first = room_for(join.num_xnodes);
  if (shared && !first)
    shared = fail(ErrorCode::kUnavailable, "the runs that are there have too many XNodes");
  if (!shared) {
    stop_unused();
    return tl::unexpected<Error>(std::move(shared).error());
  }
  lease.first_xnode = *first;
  forget_slack();
  leases_.emplace(++last_lease_, std::move(lease));
  regulate(last_lease_, join);
  return last_lease_;
}

/// Whether it can come to those that are there, and to what those have not given back that have left.
Status SystemService::test(const Leased& newcomer, bool with_regulated, bool with_departed) const {
  std::vector<Demand> demands;
  std::set<std::string> cut;
  const auto add = [&](const Demand& demand, bool regulated) {
    if (regulated && !with_regulated) return;
    demands.push_back(demand);
    if (!regulated) return;
    for (const DemandOnXpu& on : demand.xpus) cut.insert(on.xpu.id);
  };
  for (const auto& [number, other] : leases_) add(other.demand, other.regulated());
  if (with_departed)
    for (const Departed& other : departed_) add(other.demand, other.regulated);
  add(newcomer.demand, newcomer.regulated());
  // Work of others is preempted by any job, too.
  cut.insert(newcomer.beside_foreign.begin(), newcomer.beside_foreign.end());
  for (Demand& demand : demands) charge_all(demand, cut);
  return options_.admission(demands);
}

/// Tells each coordinator what a run that is not trusted may have.
void SystemService::regulate(std::uint32_t number, const Join& join) {
  const Leased& lease = leases_.at(number);
  if (!lease.regulated()) return;
  for (std::uint32_t i = 0; i < join.num_xpus; ++i) {
    coord::Regulate run{.lease = number, .hostile = is_stranger(lease.uid) ? 1u : 0u};
    for (const LeaseTask& one : lease.tasks) {
      if (one.xpu != i) continue;
      coord::SporadicTask& task = run.tasks[run.num_tasks++] = one.task;
      task.xnode += lease.first_xnode;
    }
    (void)send_packet(shared_.at(join.xpus[i].hardware).control.get(), &run, sizeof run);
  }
}

/// A coordinator for each XPU of a run.
Status SystemService::share(const Join& join) {
  for (std::uint32_t i = 0; i < join.num_xpus; ++i) {
    const std::string hardware = join.xpus[i].hardware;
    const auto discipline = static_cast<Discipline>(join.xpus[i].discipline);
    const int levels = join.xpus[i].levels;
    if (const auto found = shared_.find(hardware); found != shared_.end()) {
      if (found->second.discipline != discipline || found->second.levels != levels)
        return fail(ErrorCode::kUnavailable,
                    hardware + " is shared as " + to_string(found->second.discipline) +
                        " there, and is " + to_string(discipline) + " to this run");
      continue;
    }
    XAUTO_ASSIGN(UniqueFd record_fd, sealed_memory("xauto-record", coord::Record::kBytes));
    XAUTO_ASSIGN(coord::Record record, coord::Record::map(record_fd.get(), false));
    XAUTO_ASSIGN(UniqueFd control,
                 daemons_.start_shared(hardware, discipline, levels, record_fd.get()));
    shared_[hardware] = {.discipline = discipline,
                         .levels = levels,
                         .control = std::move(control),
                         .record_fd = std::move(record_fd),
                         .record = std::move(record),
                         .slack = {}};
    if (may_suspend_foreign(join.xpus[i])) suspend_foreign(join.xpus[i]);
  }
  return {};
}

bool SystemService::may_suspend_foreign(const JoinXpu& xpu) const {
  const std::string type = ends(xpu.type) ? xpu.type : "";
  return options_.suspend_foreign && (type == "gpu" || type == "dla") &&
         xpu.discipline == static_cast<std::uint32_t>(Discipline::kPreemptive);
}

/// Of an XPU that nobody has yet.
void SystemService::suspend_foreign(const JoinXpu& xpu) {
  const bool gpu = std::string(xpu.type) == "gpu";
  const auto room = room_for(1);
  if (!room) return;
  Shared& shared = shared_.at(xpu.hardware);
  shared.foreign_lease = {.number = ++last_lease_, .first_xnode = *room, .num_xnodes = 1};
  if (getrandom(&shared.foreign_lease.secret, sizeof shared.foreign_lease.secret, 0) < 0) return;
  const coord::Door door{
      .path = options_.path, .name = xpu.hardware, .lease = shared.foreign_lease};
  auto work =
      ForeignWork::start({.door = door.to_text(),
                          .type = gpu ? kernel::QueueType::kGpuTsg : kernel::QueueType::kDla,
                          .instance = gpu ? -1 : xpu.instance});
  if (!work) {
    log::warn("work of others on {} is not suspended: {}", xpu.hardware, words_of(work.error()));
    return;
  }
  shared.foreign = std::move(*work);
  tell_who_joined();
}

void SystemService::tell_who_joined() {
  std::set<pid_t> joined;
  for (const auto& [number, lease] : leases_)
    for (const RunProcess& process : lease.processes) joined.insert(process.pid());
  for (const auto& [hardware, shared] : shared_)
    if (shared.foreign) shared.foreign->set_joined(joined);
}

void SystemService::hand_on_foreign(UniqueFd worker, const coord::Attach& attach,
                                    const Shared& shared) {
  const coord::Adopt adopt{
      .lease = attach.lease, .first_xnode = shared.foreign_lease.first_xnode, .num_xnodes = 1};
  if (shared.foreign_lease.secret == attach.secret)
    (void)send_packet(shared.control.get(), &adopt, sizeof adopt, {worker.get()});
}

/// The first XNode of a run with so many: runs' numbers do not overlap.
std::optional<std::uint32_t> SystemService::room_for(std::uint32_t num_xnodes) const {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> taken;
  for (const auto& [number, lease] : leases_)
    taken.emplace_back(lease.first_xnode, lease.first_xnode + lease.num_xnodes);
  for (const auto& [hardware, shared] : shared_) {
    const coord::Lease& foreign = shared.foreign_lease;
    if (foreign.number != 0)
      taken.emplace_back(foreign.first_xnode, foreign.first_xnode + foreign.num_xnodes);
  }
  std::sort(taken.begin(), taken.end());
  std::uint32_t first = 0;
  for (const auto& [begin, end] : taken) {
    if (begin - first >= num_xnodes) return first;
    first = end;
  }
  if (coord::kMaxSharedXNodes - first >= num_xnodes) return first;
  return std::nullopt;
}

void SystemService::hand_on(UniqueFd worker, uid_t uid, const coord::Attach& attach) {
  const auto lease = leases_.find(attach.lease);
  const std::string hardware = ends(attach.hardware) ? attach.hardware : "";
  const auto shared = shared_.find(hardware);
  if (attach.version != coord::kProtocolVersion)
    return refuse_worker(worker.get(), "another protocol version");
  if (shared != shared_.end() && attach.lease != 0 &&
      shared->second.foreign_lease.number == attach.lease)
    return hand_on_foreign(std::move(worker), attach, shared->second);
  if (lease == leases_.end() || lease->second.secret != attach.secret || lease->second.uid != uid)
    return refuse_worker(worker.get(), "the run has no lease here: its service has begun again");
  if (shared == shared_.end() || !has(lease->second.demand, hardware))
    return refuse_worker(worker.get(), "the run has joined without this XPU");
  Leased& run = lease->second;
  const auto peer = peer_of(worker.get());
  const bool seen = peer && peer->pid > 0;
  const auto same = [&](const RunProcess& process) { return process.pid() == peer->pid; };
  if (run.regulated() && !seen) return refuse_worker(worker.get(), "its process is not seen");
  std::erase_if(run.processes, [](const RunProcess& process) { return !process.lives(); });
  if (seen && std::none_of(run.processes.begin(), run.processes.end(), same)) {
    if (run.processes.size() >= kMaxRunProcesses)
      return refuse_worker(worker.get(), "the run has too many processes");
    run.processes.emplace_back(worker.get(), peer->pid);
    tell_who_joined();
  }
  const coord::Adopt adopt{.lease = attach.lease,
                           .first_xnode = lease->second.first_xnode,
                           .num_xnodes = lease->second.num_xnodes,
                           .regulated = lease->second.regulated() ? 1u : 0u};
  if (!send_packet(shared->second.control.get(), &adopt, sizeof adopt, {worker.get()}))
    refuse_worker(worker.get(), "the coordinator of this XPU is gone");
}

/// The run has gone: its workers, if some still live, are nobody's.
void SystemService::end(std::uint32_t number) {
  const auto found = leases_.find(number);
  const Leased lease = std::move(found->second);
  leases_.erase(found);
  forget_slack();
  tell_who_joined();
  departed_.push_back({lease.demand, lease.regulated(), now_ns() + kMomentNs});
  const coord::Adopt over{.kind = static_cast<std::uint32_t>(coord::MessageKind::kEndLease),
                          .lease = number};
  for (const DemandOnXpu& on : lease.demand.xpus)
    if (const auto shared = shared_.find(on.xpu.id); shared != shared_.end())
      (void)send_packet(shared->second.control.get(), &over, sizeof over);
  stop_unused();
  if (lease.regulated())
    for (const RunProcess& process : lease.processes) process.lower();
  log::info("app '{}'{} has left", lease.app, of_uid(lease.uid));
}

/// All runs that are not trusted go on as ordinary ones.
void SystemService::end_regulated() {
  std::vector<std::uint32_t> numbers;
  for (const auto& [number, lease] : leases_)
    if (lease.regulated()) numbers.push_back(number);
  for (const std::uint32_t number : numbers) end(number);
}

void SystemService::stop_unused() {
  for (auto shared = shared_.begin(); shared != shared_.end();) {
    if (used(shared->first)) {
      ++shared;
      continue;
    }
    shared->second.foreign.reset();
    daemons_.end_shared(shared->first);
    shared = shared_.erase(shared);
  }
}

/// docs/monitoring.md says what the numbers are.
std::string SystemService::status(uid_t uid) {
  Json coordinators = Json::array();
  for (auto& [hardware, shared] : shared_) {
    if (!shared.slack) shared.slack = slack_of(hardware);
    coordinators.push_back({{"xpu", hardware},
                            {"pid", daemons_.pid_of(hardware)},
                            {"discipline", to_string(shared.discipline)},
                            {"slack_pct", *shared.slack ? Json(**shared.slack) : Json()}});
    if (!shared.foreign) continue;
    const ForeignWork::Told told = shared.foreign->told();
    coordinators.elements().back()["foreign"] = {{"queues", told.queues},
                                                 {"suspensions", told.suspensions},
                                                 {"not_kept_off", told.not_kept_off}};
  }
  Json all{{"at_us", now_ns() / 1000},
           {"apps", Json::array()},
           {"left_out", 0},
           {"coordinators", std::move(coordinators)},
           {"you_are_regulated", !options_.trust.trusts(uid)}};
  std::string text = all.dump();
  std::size_t bytes = text.size();
  int left_out = 0;
  for (const auto& [number, lease] : leases_) {
    Json app = status_of(number, lease);
    const std::size_t more = app.dump().size() + 8;
    if (bytes + more > coord::kMaxStatusBytes) {
      ++left_out;
      continue;
    }
    bytes += more;
    all["apps"].push_back(std::move(app));
  }
  all["left_out"] = left_out;
  return all.dump();
}

Json SystemService::status_of(std::uint32_t number, const Leased& lease) const {
  Json xpus = Json::array(), pids = Json::array();
  for (const DemandOnXpu& on : lease.demand.xpus) {
    const coord::Record::Had had = shared_.at(on.xpu.id).record.had(number);
    xpus.push_back({{"xpu", on.xpu.id},
                    {"admitted_pct", std::round(utilisation(on) * 10'000) / 100},
                    {"had_us", had.ns / 1000},
                    {"times", had.times}});
  }
  for (const RunProcess& process : lease.processes)
    if (process.lives()) pids.push_back(process.pid());
  return {{"lease", number},         {"app", lease.app},
          {"uid", lease.uid},        {"regulated", lease.regulated()},
          {"xpus", std::move(xpus)}, {"pids", std::move(pids)}};
}

/// Of all who are there. Where the demand test alone takes long, nobody waits for it for the sake of a number.
Result<int> SystemService::slack_of(const std::string& hardware) const {
  std::vector<Demand> demands;
  bool cut = false;
  for (const auto& [number, lease] : leases_)
    for (const DemandOnXpu& on : lease.demand.xpus) {
      if (on.xpu.id != hardware) continue;
      demands.push_back({lease.demand.ticks_per_us, {on}});
      cut = cut || lease.regulated() || lease.beside_foreign.contains(hardware);
    }
  if (cut)
    for (Demand& demand : demands) charge_all(demand, {hardware});
  const std::int64_t since = now_ns();
  XAUTO_TRY(options_.admission(demands));
  if (!options_.slack || now_ns() - since > kSlackNs)
    return fail(ErrorCode::kTimeout, "takes too long", hardware);
  return options_.slack(demands);
}

void SystemService::forget_slack() {
  for (auto& [hardware, shared] : shared_) shared.slack.reset();
}

void SystemService::show_records(int socket, uid_t uid) const {
  Json xpus = Json::array();
  std::vector<UniqueFd> records;
  std::vector<int> fds;
  const bool trusted = options_.trust.trusts(uid);
  for (const auto& [hardware, shared] : shared_) {
    if (!trusted || fds.size() == kMostShown) break;
    auto record = read_only(shared.record_fd.get());
    if (!record) continue;
    xpus.push_back(hardware);
    fds.push_back(record->get());
    records.push_back(std::move(*record));
  }
  const std::string text = Json({{"xpus", xpus}, {"trusted", trusted}}).dump();
  (void)send_packet(socket, text.data(), text.size(), fds);
}

/// One that nobody uses any more has no coordinator.
void SystemService::forget_departed() {
  const std::int64_t now = now_ns();
  for (Departed& one : departed_)
    if (now >= one.look_ns)
      std::erase_if(one.demand.xpus, [&](const DemandOnXpu& on) {
        const auto shared = shared_.find(on.xpu.id);
        const bool foreign = shared != shared_.end() && shared->second.foreign;
        return daemons_.idle(on.xpu.id, foreign ? shared->second.foreign->slot() : -1);
      });
  std::erase_if(departed_, [](const Departed& one) { return one.demand.xpus.empty(); });
}

bool SystemService::used(const std::string& hardware) const {
  return std::any_of(leases_.begin(), leases_.end(),
                     [&](const auto& lease) { return has(lease.second.demand, hardware); });
}

}  // namespace xauto::launch
