// SPDX-License-Identifier: Apache-2.0
#include "kernel/run_maps.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include <sys/stat.h>

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

struct Known {
  const char* name;
  std::size_t value_size;
  std::size_t key_size = sizeof(std::uint32_t);
};
constexpr std::array<Known, 8> kKnown = {
    {{"head", sizeof(xauto_bpf_head)},
     {"table", sizeof(xauto_bpf_entry)},
     {"slots", sizeof(xauto_bpf_slot)},
     {"jobs", sizeof(xauto_bpf_job)},
     {"sched", sizeof(xauto_bpf_sched)},
     {"counts", sizeof(xauto_bpf_counts)},
     {"names", sizeof(xauto_bpf_name)},
     {"threads", 2 * sizeof(std::uint64_t), sizeof(std::uint64_t)}}};

/// Rows of the table for apps that join the run.
constexpr std::uint32_t kSpare = 512;

}  // namespace

std::string RunMaps::folder(const std::string& run) {
  return RunFolder::path_of(run);
}

std::vector<std::string> RunMaps::runs() {
  std::vector<std::string> runs = RunFolder::alive();
  // The head is the first, the policy the last; a run without BPF programs has the policy alone.
  std::erase_if(runs, [](const std::string& run) {
    std::error_code error;
    return fs::exists(folder(run) + "/policy", error) && !fs::exists(folder(run) + "/head", error);
  });
  return runs;
}

RunMaps& RunMaps::operator=(RunMaps&& other) noexcept {
  std::swap(run_, other.run_);
  std::swap(own_, other.own_);
  std::swap(first_, other.first_);
  std::swap(xnodes_, other.xnodes_);
  std::swap(life_, other.life_);
  std::swap(maps_, other.maps_);
  std::swap(head_, other.head_);
  std::swap(table_, other.table_);
  std::swap(slots_, other.slots_);
  std::swap(jobs_, other.jobs_);
  std::swap(sched_, other.sched_);
  std::swap(names_, other.names_);
  return *this;
}

RunMaps::~RunMaps() {
  if (maps_.empty()) return;
  if (!own_ && xnodes_ > 0) {
    const LockOfAllRuns lock;
    give_back({first_, xnodes_});
  }
}

/// What no table has any more, and nobody's name, is free again.
void RunMaps::give_back(const Range& range) {
  publish(range, {});
  std::fill_n(names_.as<xauto_bpf_name>() + range.first, range.count, xauto_bpf_name{});
  rmdir(folder_of(range).c_str());
}

/// Of a joined run, below that of the run.
std::string RunMaps::folder_of(const Range& range) const {
  return folder(run_) + "/joined-" + std::to_string(range.first) + "-" +
         std::to_string(range.count);
}

/// Of joined runs that were killed.
void RunMaps::give_back_of_the_dead() {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder(run_), error)) {
    Range rows;
    const std::string name = entry.path().filename().string();
    if (sscanf(name.c_str(), "joined-%u-%u", &rows.first, &rows.count) == 2 &&
        rows.first < head().xnodes && rows.count <= head().xnodes - rows.first &&
        !somebody_lives_in(entry.path().string()))
      give_back(rows);
  }
}

Result<RunMaps> RunMaps::create(const std::string& run, std::uint32_t xnodes, std::uint32_t slots) {
  if (xnodes == 0 || xnodes > XAUTO_BPF_MAX_XNODES)
    return fail(ErrorCode::kInvalid, std::to_string(xnodes) + " XNodes; the BPF table holds 1 to " +
                                         std::to_string(XAUTO_BPF_MAX_XNODES));
  slots = std::clamp<std::uint32_t>(slots, 1, XAUTO_BPF_MAX_SLOTS);
  XAUTO_TRY(bpf_is_built_in());
  RunMaps maps;
  XAUTO_ASSIGN(maps.own_, RunFolder::make(run));
  maps.run_ = run;
  const std::uint32_t rows = std::min<std::uint32_t>(xnodes + kSpare, XAUTO_BPF_MAX_XNODES);
  XAUTO_ASSIGN(maps.maps_, load_maps(folder(run), rows, slots));
  XAUTO_TRY(maps.map_all(true));
  auto& head = *maps.head_.as<xauto_bpf_head>();
  head.xnodes = rows;
  head.slots = slots;
  head.owner = static_cast<__u64>(getpid());
  // Last: who opens the maps meanwhile reads 0, and knows that they are not ready.
  __atomic_store_n(&head.abi, XAUTO_BPF_ABI, __ATOMIC_RELEASE);
  maps.xnodes_ = xnodes;
  return maps;
}

Result<RunMaps> RunMaps::join(const std::string& run, std::uint32_t xnodes) {
  XAUTO_ASSIGN(RunMaps maps, open(run, true));
  const LockOfAllRuns lock;
  maps.give_back_of_the_dead();
  const __u64 version = maps.head().version;
  const xauto_bpf_entry* table = maps.bank(version);
  auto* names = maps.names_.as<xauto_bpf_name>();
  std::uint32_t free = 0, end = 0;
  for (; end < maps.head().xnodes && free < xnodes; ++end)
    free = names[end].xnode[0] == 0 && table[end].version != version ? free + 1 : 0;
  if (version == 0 || xnodes == 0 || free < xnodes)
    return fail(ErrorCode::kUnavailable,
                "run " + run + " has no room for " + std::to_string(xnodes) + " more XNodes");
  const std::string own = maps.folder_of({end - xnodes, xnodes});
  if (mkdir(own.c_str(), 0700) != 0)
    return fail(ErrorCode::kIo, own + ": " + strerror(errno), {}, bpf_hint());
  maps.life_ = live_in(own);
  maps.first_ = end - xnodes;
  maps.xnodes_ = xnodes;
  for (std::uint32_t i = maps.first_; i < end; ++i) names[i].xnode[0] = '?';
  return maps;
}

Result<RunMaps> RunMaps::open(const std::string& run) {
  return open(run, false);
}

Result<RunMaps> RunMaps::open(const std::string& run, bool writes) {
  XAUTO_TRY(RunFolder::check_name(run));
  RunMaps maps;
  maps.run_ = run;
  for (const Known& known : kKnown) {
    XAUTO_ASSIGN(UniqueFd fd, open_pinned_map(folder(run) + "/" + known.name));
    XAUTO_TRY(check_shape(fd.get(), known.name, known.value_size, 1, known.key_size));
    maps.maps_.push_back({known.name, std::move(fd)});
  }
  XAUTO_TRY(maps.map_all(writes));
  const xauto_bpf_head& head = maps.head();
  const auto abi = __atomic_load_n(&head.abi, __ATOMIC_ACQUIRE);
  if (abi == 0)
    return fail(ErrorCode::kNotFound, "the run is just starting", folder(run), "try again");
  if (abi != XAUTO_BPF_ABI)
    return fail(ErrorCode::kInvalid,
                "maps of layout " + std::to_string(abi) + ", this program knows layout " +
                    std::to_string(XAUTO_BPF_ABI),
                folder(run), "use one version of XAuto for all");
  if (head.xnodes == 0 || head.xnodes > XAUTO_BPF_MAX_XNODES || head.slots == 0 ||
      head.xnodes > maps.names_.size() || head.slots > maps.slots_.size() ||
      head.slots > maps.jobs_.size() ||
      std::uint64_t{head.xnodes} * XAUTO_BPF_BANKS > maps.table_.size())
    return fail(ErrorCode::kInvalid, "the map 'head' contradicts the sizes of the others",
                folder(run), "remove the folder");
  return maps;
}

Status RunMaps::map_all(bool writes) {
  const auto attach = [&](MappedMap& into, const char* name, std::size_t size,
                          bool writable) -> Status {
    auto mapped = MappedMap::map(fd(name), size, writable);
    if (!mapped) {
      Error error = std::move(mapped).error();
      error.where = "map '" + std::string(name) + "'";
      return tl::unexpected<Error>(std::move(error));
    }
    into = std::move(*mapped);
    return {};
  };
  XAUTO_TRY(attach(head_, "head", sizeof(xauto_bpf_head), writes));
  XAUTO_TRY(attach(table_, "table", sizeof(xauto_bpf_entry), writes));
  XAUTO_TRY(attach(slots_, "slots", sizeof(xauto_bpf_slot), false));
  XAUTO_TRY(attach(jobs_, "jobs", sizeof(xauto_bpf_job), false));
  XAUTO_TRY(attach(sched_, "sched", sizeof(xauto_bpf_sched), false));
  return attach(names_, "names", sizeof(xauto_bpf_name), writes);
}

int RunMaps::fd(const std::string& name) const {
  for (const NamedMap& map : maps_)
    if (map.name == name) return map.fd.get();
  return -1;
}

Status RunMaps::pin(int map_fd, const std::string& name) const {
  return pin_map(map_fd, folder(run_) + "/" + name);
}

Status RunMaps::set_names(const std::vector<XNodeName>& names) {
  if (names.size() != xnodes_)
    return fail(ErrorCode::kInvalid,
                std::to_string(names.size()) + " names for " + std::to_string(xnodes_) + " XNodes");
  const LockOfAllRuns lock;
  auto* into = names_.as<xauto_bpf_name>() + first_;
  for (std::size_t i = 0; i < names.size(); ++i) {
    into[i] = {};
    names[i].xnode.copy(into[i].xnode, sizeof into[i].xnode - 1);
    names[i].xpu.copy(into[i].xpu, sizeof into[i].xpu - 1);
    into[i].at = names[i].at;
  }
  return {};
}

std::vector<XNodeName> RunMaps::names() const {
  std::vector<XNodeName> names(head().xnodes);
  const auto* from = names_.as<xauto_bpf_name>();
  for (std::size_t i = 0; i < names.size(); ++i)
    names[i] = {std::string(from[i].xnode, strnlen(from[i].xnode, sizeof from[i].xnode)),
                std::string(from[i].xpu, strnlen(from[i].xpu, sizeof from[i].xpu)), from[i].at};
  return names;
}

Result<xauto_bpf_counts> RunMaps::counts() const {
  XAUTO_ASSIGN(const std::size_t cpus, possible_cpus());
  std::vector<xauto_bpf_counts> each(cpus);
  const std::uint32_t only = 0;
  XAUTO_TRY(get_element(fd("counts"), &only, each.data()));
  xauto_bpf_counts sum{};
  for (const xauto_bpf_counts& cpu : each)
    for (std::size_t i = 0; i < XAUTO_BPF_STATS; ++i) sum.stats[i] += cpu.stats[i];
  return sum;
}

std::uint64_t RunMaps::version() const {
  return std::atomic_ref(head_.as<xauto_bpf_head>()->version).load(std::memory_order_acquire);
}

Status RunMaps::replace_table(const std::vector<TableRow>& rows) {
  if (xnodes_ == 0)
    return fail(ErrorCode::kPermission, "only the process that made the table replaces it", run_);
  if (rows.size() != xnodes_)
    return fail(ErrorCode::kInvalid, "a table of " + std::to_string(rows.size()) + " rows for " +
                                         std::to_string(xnodes_) + " XNodes");
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const TableRow& row = rows[i];
    const bool on_cpu = row.cpu != XAUTO_BPF_NO_CPU;
    if (on_cpu && (row.cpu >= XAUTO_BPF_MAX_CPUS || row.key <= -XAUTO_BPF_KEY_LIMIT ||
                   row.key >= XAUTO_BPF_KEY_LIMIT || row.budget_us < 0))
      return fail(ErrorCode::kInvalid,
                  "row " + std::to_string(i) + ": CPU " + std::to_string(row.cpu) + ", key " +
                      std::to_string(row.key) + ", budget " + std::to_string(row.budget_us) +
                      " us; CPUs are below " + std::to_string(XAUTO_BPF_MAX_CPUS) +
                      ", keys within 2^60 of 0");
  }
  const LockOfAllRuns lock;
  publish({first_, xnodes_}, rows);
  return {};
}

/// Those of `range` that `rows` lacks are nobody's then.
void RunMaps::publish(const Range& range, const std::vector<TableRow>& rows) {
  auto& head = *head_.as<xauto_bpf_head>();
  const __u64 version = head.version + 1;
  const xauto_bpf_entry* from = bank(head.version);
  xauto_bpf_entry* into = bank(version);
  for (std::uint32_t i = 0; i < head.xnodes; ++i) {
    const std::uint32_t ours = i - range.first;
    const bool mine = ours < range.count;
    // Nobody's row: not of the table in force.
    if (mine ? ours >= rows.size() : head.version == 0 || from[i].version != head.version) continue;
    xauto_bpf_entry entry = from[i];
    if (mine)
      entry = {.key = rows[ours].key,
               .budget_ns = static_cast<__u64>(rows[ours].budget_us) * 1000,
               .cpu = rows[ours].cpu};
    std::atomic_ref stamp(into[i].version);
    stamp.store(0, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_seq_cst);
    std::atomic_ref(into[i].cpu).store(entry.cpu, std::memory_order_relaxed);
    std::atomic_ref(into[i].key).store(entry.key, std::memory_order_relaxed);
    std::atomic_ref(into[i].budget_ns).store(entry.budget_ns, std::memory_order_relaxed);
    stamp.store(version, std::memory_order_release);
  }
  std::atomic_ref(head.version).store(version, std::memory_order_seq_cst);
}

}  // namespace xauto::kernel
