// SPDX-License-Identifier: Apache-2.0
// The BPF maps of one run (include/uapi/xauto/bpf.h): made by the xauto tool before the app starts,
// pinned under /sys/fs/bpf/xauto/RUN/ for the scheduler, the tracer and bpftool, gone with the
// tool.
//
// Threads: one at a time.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <uapi/xauto/bpf.h>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "kernel/bpf_sys.h"
#include "kernel/run_folder.h"

namespace xauto::kernel {

/// Whether this build has the BPF programs at all, and if not, why.
[[nodiscard]] Status bpf_is_built_in();

struct NamedMap {
  std::string name;
  UniqueFd fd;
};

/// What the policy says of one XNode, for the table.
struct TableRow {
  std::uint32_t cpu = XAUTO_BPF_NO_CPU;  ///< the kernel's number
  std::int64_t key = 0;        ///< of a priority (coord/rule.h); 0: each job tells its own
  std::int64_t budget_us = 0;  ///< 0: none
};

struct XNodeName {
  std::string xnode, xpu;
  std::uint32_t at = 0;  ///< index of the XPU in the platform
};

class RunMaps {
 public:
  /// `run`: a name of letters, digits and dashes. Removes what runs that were killed left behind.
  [[nodiscard]] static Result<RunMaps> create(const std::string& run, std::uint32_t xnodes,
                                              std::uint32_t slots);
  /// A second app under the scheduler of `run`: `xnodes` of the rows that its table has to spare.
  /// They are given back with this object, or found by the next who joins if this process is killed.
  /// `first()` says from where on.
  [[nodiscard]] static Result<RunMaps> join(const std::string& run, std::uint32_t xnodes);
  /// The maps that another process made; their layout is checked.
  [[nodiscard]] static Result<RunMaps> open(const std::string& run);
  /// Names of the runs that have maps and whose maker lives.
  [[nodiscard]] static std::vector<std::string> runs();
  [[nodiscard]] static std::string folder(const std::string& run);

  RunMaps(RunMaps&&) noexcept = default;
  RunMaps& operator=(RunMaps&& other) noexcept;
  ~RunMaps();

  /// Puts a new table into force, as a whole: each job goes by the one that it began with. Rows of
  /// other apps stay as they are.
  [[nodiscard]] Status replace_table(const std::vector<TableRow>& rows);
  /// What the numbers mean, for those who look from outside.
  [[nodiscard]] Status set_names(const std::vector<XNodeName>& names);
  [[nodiscard]] std::vector<XNodeName> names() const;
  /// A number that grows with each replacement.
  [[nodiscard]] std::uint64_t version() const;

  /// Number of our XNode 0 in the maps; 0 of who made them.
  [[nodiscard]] std::uint32_t first() const { return first_; }
  [[nodiscard]] const std::string& run() const { return run_; }
  [[nodiscard]] const xauto_bpf_head& head() const { return *head_.as<xauto_bpf_head>(); }
  [[nodiscard]] const xauto_bpf_slot* slots() const { return slots_.as<xauto_bpf_slot>(); }
  [[nodiscard]] const xauto_bpf_job* jobs() const { return jobs_.as<xauto_bpf_job>(); }
  [[nodiscard]] const xauto_bpf_sched& sched() const { return *sched_.as<xauto_bpf_sched>(); }
  /// What the scheduler has counted, over all CPUs.
  [[nodiscard]] Result<xauto_bpf_counts> counts() const;
  [[nodiscard]] const xauto_bpf_entry* table() const { return table_.as<xauto_bpf_entry>(); }

  /// Descriptors of the maps by name: "head", "table", "slots", "jobs", "sched", "counts",
  /// "names", "threads".
  [[nodiscard]] int fd(const std::string& name) const;
  /// Pins one more map of this run, which goes with the run.
  [[nodiscard]] Status pin(int map_fd, const std::string& name) const;

 private:
  RunMaps() = default;
  [[nodiscard]] static Result<RunMaps> open(const std::string& run, bool writes);
  [[nodiscard]] Status map_all(bool writes);
  struct Range {
    std::uint32_t first = 0, count = 0;
  };
  [[nodiscard]] std::string folder_of(const Range& joined) const;
  // These three under the lock of all runs.
  void publish(const Range& range, const std::vector<TableRow>& rows);
  void give_back(const Range& range);
  void give_back_of_the_dead();
  [[nodiscard]] xauto_bpf_entry* bank(std::uint64_t version) const {
    return table_.as<xauto_bpf_entry>() + (version % XAUTO_BPF_BANKS) * head().xnodes;
  }
  std::string run_;
  std::optional<RunFolder> own_;          ///< made them; nullopt: another run did
  std::uint32_t first_ = 0, xnodes_ = 0;  ///< the rows that are ours to write; 0: none
  UniqueFd life_;  ///< of a joined run, its folder: locked as long as this process lives
  std::vector<NamedMap> maps_;
  MappedMap head_, table_, slots_, jobs_, sched_, names_;
};

/// In libbpf/maps.cc: makes and pins the maps.
[[nodiscard]] Result<std::vector<NamedMap>> load_maps(const std::string& folder,
                                                      std::uint32_t xnodes, std::uint32_t slots);

}  // namespace xauto::kernel
