// SPDX-License-Identifier: Apache-2.0
// Of a run with tables: for how long a job may have its XPU where what is claimed shall hold. A scenario
// claims something of jobs within its own WCETs where no source has a rate; else a table, of all scenarios that it serves
// together. A change covers jobs of both its sides. Unlike the choice of a scenario
// (tables/scenario_choice.h), this forgives no stall of the emulator's machine: nobody is told of a short
// one, and it makes a chain longer all the same.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "session/session.h"

namespace xauto::runtime {

/// What a job may take before it counts as longer than its WCET. An emulated one takes a little more.
[[nodiscard]] std::int64_t watched_ns(std::int64_t wcet_us, bool emulated);

class ClaimedWcets {
 public:
  /// `session` has tables.
  explicit ClaimedWcets(const Session& session);
  /// What a job of `xnode` may take where `table` places it, while `scenario` is in force, in ns; 0: there
  /// is no such job.
  [[nodiscard]] std::int64_t under(std::size_t scenario, std::size_t table,
                                   std::size_t xnode) const;
  /// The least of these over all scenarios that `table` serves.
  [[nodiscard]] std::int64_t least(std::size_t table, std::size_t xnode) const;
  /// Where `table` places it, no scenario whatever allows less; 0: there is no such job.
  [[nodiscard]] std::int64_t shortest(std::size_t table, std::size_t xnode) const {
    return shortest_ns_[at(table, xnode)];
  }

 private:
  [[nodiscard]] std::size_t at(std::size_t table, std::size_t xnode) const {
    return table * xnodes_ + xnode;
  }
  std::size_t xnodes_;
  std::vector<std::size_t> row_of_;                   ///< [scenario]; at rates its table
  std::vector<std::vector<std::int64_t>> ns_;         ///< [row][at()]
  std::vector<std::int64_t> least_ns_, shortest_ns_;  ///< [at()]
};

}  // namespace xauto::runtime
