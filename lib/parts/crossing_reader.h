// SPDX-License-Identifier: Apache-2.0
// What one host reads of one XNode of another host, and the watch of its X (docs/keys.md, "Hosts").
//
// Release k of the sender's component has its key at due(k) + key_us[k mod n]. Its message counts if it is here, by our
// clock, by that key + X. Else release k is lost for who reads it here: a tombstone goes on in its place, and what comes
// later is counted and thrown away. So nobody waits longer than X for anybody, and nobody needs to know how far the two
// clocks are apart.
//
// Nor does one go on before its release, by our clock: a sender whose clock is ahead would start our jobs before their
// earliest start, from which it follows what they know of what they sample.
//
// Messages go on in the order of releases. One that overtakes others waits for them, at most until their X: keys do not
// fall from one release to the next, so that is before its own.
//
// A pure function of (messages, instants): it reads no clock.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <utility>
#include <vector>

#include "grid/grid.h"
#include "model/message.h"

namespace xauto::parts {

/// Messages that wait for an older one, at most.
inline constexpr std::uint64_t kMostWaiting = 64;

/// All instants: ns after the run's start, as our clock reads them. Threads: one.
class CrossingReader {
 public:
  struct Rule {
    runtime::Grid::Source releases;    ///< of the sender's component
    std::vector<std::int64_t> key_us;  ///< of the sender, Placement::key_us
    std::int64_t x_us = 0;
    std::int64_t urgent_by_us = 0;  ///< an urgent release has its key so much sooner
    /// What an emulated sender may take beside its key, in percent and us (model/claims.h); 0: it is real.
    std::int64_t more_pct = 0, more_us = 0;
    /// Until when the message of that release has to be here.
    [[nodiscard]] std::int64_t by_ns(std::uint64_t number, bool urgent = false) const;
  };
  struct Count {
    std::uint64_t expected = 0;   ///< releases whose X is over, or whose message came before
    std::uint64_t lost = 0;       ///< of these: the message was not here by X
    std::uint64_t late = 0;       ///< of these: it came later
    std::int64_t latest_ns = 0;   ///< by how much, the most
    std::int64_t longest_ns = 0;  ///< of what came: from its key, by our clock; at least 0
    std::uint64_t none = 0;       ///< releases that the sender had no result of, and said so
    std::uint64_t twice = 0;      ///< messages that had come before
    std::uint64_t refused = 0;    ///< messages of releases that the plan has not, or far ahead
  };
  using Deliver = std::function<void(const detail::Envelope&)>;

  /// Reads from release `first` on.
  CrossingReader(Rule rule, std::uint64_t first)
      : rule_(std::move(rule)), next_(first), first_(first) {}
  /// No release at this instant, or later, is expected.
  void end(std::int64_t end_ns) { end_ns_ = end_ns; }

  /// Releases first..number have come: `message` of `number`, or, if it has none, that there are none. `nominal_ns`: as
  /// the sender says. False: lost by its X, twice, or refused.
  bool arrive(std::uint64_t first, const detail::Envelope& message, std::int64_t nominal_ns,
              std::int64_t now_ns);
  /// Hands on what is complete by now, and a tombstone for what is lost by now.
  void pass(std::int64_t now_ns, const Deliver& deliver);
  /// When `pass` has something to do if nothing comes; INT64_MAX: never.
  [[nodiscard]] std::int64_t next_ns() const;
  /// All that is expected has come, or is lost.
  [[nodiscard]] bool over() const { return rule_.releases.due_ns(next_) >= end_ns_; }
  [[nodiscard]] const Count& count() const { return count_; }
  /// 1 + the last release that was lost; 0: none was.
  [[nodiscard]] std::uint64_t last_lost() const { return last_lost_; }

 private:
  void advance(std::int64_t now_ns);
  void lose(std::uint64_t number);
  void count_late(std::uint64_t number, std::int64_t late_ns);

  const Rule rule_;
  std::uint64_t next_;  ///< the oldest that is not ready
  const std::uint64_t first_;
  std::int64_t end_ns_ = INT64_MAX;
  std::map<std::uint64_t, detail::Envelope> waiting_;  ///< by release, from next_ on
  std::vector<detail::Envelope> ready_;                ///< to be handed on, in order
  /// [release mod its size] 1 + the release, if it was lost and nothing of it has come since.
  std::vector<std::uint64_t> missing_ = std::vector<std::uint64_t>(1024, 0);
  std::uint64_t last_lost_ = 0;
  Count count_;
};

}  // namespace xauto::parts
