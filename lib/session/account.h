// SPDX-License-Identifier: Apache-2.0
// The account of a run: what is claimed of each chain, under which assumptions, what was measured, and whether the
// claims were kept. Whoever tells of a run tells this: report, top, monitor, Perfetto, the page and App::run. A run
// that goes on has one as well (processes/board_account.h).
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "session/distribution.h"

namespace xauto {
class Json;
}

namespace xauto::runtime {

/// Something that claims take for granted (model/claims.h), or of which a run is watched all the same.
struct Assumption {
  std::string kind;         ///< for programs, "wcet_overrun"; docs/monitoring.md has all
  std::uint64_t count = 0;  ///< how often it was not kept; 0: it was, as far as is watched
  std::vector<std::string>
      words;  ///< how it was not, a line each; empty: it was kept, or claims do not rest on it
  [[nodiscard]] bool broken() const { return !words.empty(); }
};

/// What took time away from the run, and is no job of it: a machine that ran something else.
struct TakenReport {
  std::string what;     ///< for people
  std::int64_t us = 0;  ///< the most at once; of what is only known as a sum, all of it
};

/// A chain from a sensor to a result (account/routes.h), or the app as a whole.
struct ChainAccount {
  std::string name, from, to;
  std::int64_t deadline_us = 0,
               max_age_us = 0;  ///< as app.json and the deployment state them; 0: they do not
  /// Claimed by the policy, by tables the largest of all; 0: nothing is. `urgent`: of releases that the source marks so.
  std::int64_t worst_case_us = 0, lower_bound_us = 0, urgent_worst_case_us = 0;
  Distribution latency_us, age_us;
  Distribution urgent_us;                                ///< of latency_us, the urgent releases
  std::int64_t longest_us = -1, longest_urgent_us = -1;  ///< -1: there was none
  std::uint64_t deadline_misses =
      0;                         ///< results later than the deadline, and releases lost beyond it
  std::uint64_t age_misses = 0;  ///< results that became older than max_age_us
  /// Releases without a result when the run was over: no later one knows them either. Of a run that goes on, and
  /// where results are counted by activations (routes.h), activations of `to` that failed or were dropped.
  std::uint64_t lost = 0;
  /// In lockstep: results that waited for another release. They have a time that measures nothing.
  std::uint64_t not_measured = 0;
  /// Results that took longer than what is claimed of them (by tables: by their scenario, or by the change that they
  /// met), and more than the emulator's own part; of these the worst, and what was claimed of it.
  std::uint64_t over_claim = 0;
  std::int64_t over_us = 0, over_claimed_us = 0;
  bool urgent_exceeded = false;

  [[nodiscard]] std::uint64_t results() const { return latency_us.count(); }
  [[nodiscard]] bool exceeded() const { return over_claim > 0 || urgent_exceeded; }
};

/// What a run's policy claims.
enum class Claimed : std::uint8_t {
  kNothing,
  kOfRates,      ///< kKeyScope
  kOneAtATime,   ///< kOneAtATimeScope
  kUncertified,  ///< nothing: the policy is not certified, and says so
};

inline constexpr const char* kNotCertified =
    "nothing is claimed: the policy is not certified (`xauto solve` says what would make it so)";

/// What became of what is claimed.
enum class Verdict : std::uint8_t {
  kNothingClaimed,
  kKept,        ///< as far as it is watched
  kNotClaimed,  ///< nothing took longer, and an assumption was broken
  kExceeded,    ///< ... and every assumption that is watched was kept
  kBothBroken,  ///< something took longer, and an assumption was broken
};
[[nodiscard]] const char* to_string(Verdict verdict);  ///< for programs: "kept", "not claimed", ...

/// Of several reasons: on one line, or on a line each.
enum class Layout : std::uint8_t { kLine, kList };

/// Threads: none of its own; a value.
struct Account {
  std::string scope;  ///< which executions the claims are of, in words; empty: nothing is claimed
  std::string why_nothing;  ///< nothing is claimed, and why, if there is more to say
  bool goes_on = false;     ///< what took time away is told when it ends
  std::vector<ChainAccount> chains;
  std::vector<Assumption> assumptions;
  std::vector<TakenReport> taken;
  std::string not_watched;  ///< why some of what takes time is not watched here; empty: it is
  bool change_exceeded =
      false;  ///< of a run that goes on: what met a change of the scenario took longer

  [[nodiscard]] bool claims() const { return !scope.empty(); }
  [[nodiscard]] bool exceeded() const;
  [[nodiscard]] bool stands() const;  ///< something is claimed, and no assumption was broken
  [[nodiscard]] std::vector<std::string> broken() const;  ///< a line each
  [[nodiscard]] Verdict verdict() const;
  /// What took time away from the run, the most first, as far as that is as long as what is to be explained, or longer
  /// than kEmulatorUs; where waiting is not watched, that.
  [[nodiscard]] std::vector<std::string> taken_from() const;
  /// "worst cases of every release, ...: kept, as far as it is watched". Who took time away is named where nothing was
  /// broken; without any a run that exceeds its claims is our fault, and says so.
  [[nodiscard]] std::string words(Layout layout = Layout::kLine) const;
  /// The same without what the claims are of.
  [[nodiscard]] std::string verdict_words(Layout layout = Layout::kLine) const;

  /// Counts one more kind; with words it is broken. Of a kind that is there the larger count stays, and the words of
  /// whoever spoke first.
  void add(std::string_view kind, std::uint64_t count, std::vector<std::string> words);
  void add(std::string_view kind, std::uint64_t count, const std::string& words);
  /// How often; 0 also where nobody looks.
  [[nodiscard]] std::uint64_t count_of(std::string_view kind) const;
};

/// Sets `scope`, or why there is none.
void claim_on(Account& account, Claimed claimed);

/// p50, p99 and max; null where there are too few values.
[[nodiscard]] Json quantiles_json(const Distribution& us);
/// The member `claims` of everything that tells of a run (docs/formats.md).
[[nodiscard]] Json claims_json(const Account& account);
/// A chain of `chains`.
[[nodiscard]] Json chain_json(const ChainAccount& chain);

}  // namespace xauto::runtime
