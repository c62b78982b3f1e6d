// SPDX-License-Identifier: Apache-2.0
// What the sources did that is not as app.json states.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "grid/context.h"
#include "grid/phase.h"
#include "session/account.h"

namespace xauto::runtime {

/// Threads: one at a time.
class SourceAccount {
 public:
  explicit SourceAccount(const Context& context)
      : context_(context), seen_(context.graph.sources.size()) {}
  /// Its release came so long after its nominal instant.
  void released(std::size_t source, std::int64_t after_ns);
  /// Pushed: there was no message.
  void left_out(std::size_t source);
  /// ... one came, as ClockPhase has seen it.
  void came(std::size_t source, std::int64_t at_ns, std::int64_t off_ns, bool early);
  /// Polled: making its message took so much of what was to be its latency.
  void made(std::size_t source, std::int64_t after_ns);
  /// ... it was urgent, and nothing certifies that.
  void unheard(std::size_t source) { ++seen_[source].unheard; }
  /// Release `number` is marked urgent. False: too soon after the one before, it is an ordinary one.
  [[nodiscard]] bool urgent(std::size_t source, std::uint64_t number);
  /// For people.
  [[nodiscard]] std::vector<std::string> notes() const;
  /// `phases`: [clock] of what is pushed in a run by keys.
  void report(const std::vector<std::unique_ptr<ClockPhase>>& phases, Account& into) const;

  struct Seen {
    std::uint64_t of = 0;
    std::uint64_t late = 0;  ///< later than the stated jitter
    std::int64_t latest_ns = 0;
    std::int64_t made_late_ns = 0;
    std::uint64_t off = 0;    ///< pushed: for which its grid had to be moved
    std::uint64_t early = 0;  ///< ... since they came too soon
    std::uint64_t came = 0;   ///< pushed: messages, the first and the last of them when
    std::int64_t first_ns = 0, last_ns = 0;
    std::int64_t farthest_ns = 0;
    std::uint64_t left_out = 0;
    std::uint64_t unheard = 0;
    std::uint64_t too_soon = 0;
    std::optional<std::uint64_t> last_urgent = {};  ///< its number
  };

 private:
  const Context& context_;
  std::vector<Seen> seen_;  ///< [source]
};

}  // namespace xauto::runtime
