// SPDX-License-Identifier: Apache-2.0
// AppSpec: what is to be scheduled, a DAG of XNodes with a WCET per XPU type. File: app.json.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/period.h"
#include "model/platform.h"

namespace xauto {

/// XPU type, of those in wcet_us -> execution time in us that is usual there, at most the WCET.
using TypicalTimes = std::map<std::string, std::int64_t, std::less<>>;

/// What an XNode takes on XPUs of type `on` beside a load: while jobs run on so many others of each type, and on no more.
/// It is no longer beside less.
struct BesideSpec {
  std::string on;                                         ///< of those in wcet_us
  std::map<std::string, std::int64_t, std::less<>> load;  ///< XPU type -> XPUs, 1..kMaxXpus
  std::int64_t wcet_us = 0;                               ///< at least wcet_us on that type
  bool operator==(const BesideSpec&) const = default;
};

/// Another implementation of an XNode: less work for a result of less quality.
struct VariantSpec {
  std::string name;
  std::int64_t quality_pct = 100;  ///< of the XNode's own, 1..100
  std::map<std::string, std::int64_t, std::less<>> wcet_us;
  std::map<std::string, std::int64_t, std::less<>> memory_kb = {};  ///< as XNodeSpec's
  TypicalTimes typical_us = {};
  bool operator==(const VariantSpec&) const = default;
};

struct XNodeSpec {
  std::string name;    ///< unique in the app, "fcd.infer"
  std::string module;  ///< XModule it belongs to
  /// XPU type -> WCET in us; one key per type that the XNode has an implementation for.
  std::map<std::string, std::int64_t, std::less<>> wcet_us;
  /// Indices into AppSpec::sources: what an XNode without predecessors hears of; empty: not known.
  std::vector<int> sources = {};
  /// XPU types, of those in wcet_us, on which it computes itself: what it was measured on was no
  /// emulated stand-in. Where it runs there, the XPU has to be real.
  std::set<std::string, std::less<>> real_on = {};
  std::vector<VariantSpec> variants = {};  ///< beside wcet_us; a set of tables may choose them
  /// XPU type, of those in wcet_us -> what `init` added to the process's resident memory when it was measured.
  std::map<std::string, std::int64_t, std::less<>> memory_kb = {};
  TypicalTimes typical_us = {};  ///< no policy depends on it
  /// Where it states a type of load, wcet_us is what it takes without. Of others nothing is known: it is taken to be
  /// as long beside them. contention.h reads it.
  std::vector<BesideSpec> beside = {};
  std::int64_t message_bytes =
      0;  ///< what it sends to another host, where somebody there hears it; 0: not stated

  [[nodiscard]] std::optional<std::int64_t> wcet_on(std::string_view type) const;
  [[nodiscard]] int find_variant(std::string_view variant) const;  ///< index or -1
  bool operator==(const XNodeSpec&) const = default;
};

/// Of a source that states no rate. A release comes when the one before has ended, so two of them never meet: for a
/// plan that is as good as any time that no release takes.
inline constexpr Period kNoRate{kMaxPeriodUs};

/// Sources of one clock keep their phases. Sources of different clocks have no phase, and drift.
struct ClockSpec {
  std::string name;      ///< "main"
  std::int64_t ppm = 0;  ///< how much faster or slower it may be than nominal
  bool operator==(const ClockSpec&) const = default;
};

/// Releases of a source that a program may mark urgent: the keys of all that hears of such a release, or of what
/// `marked_by` made of it, by edges, move forward by `by_us`, and holds with them, at most to the nominal release.
struct UrgentSpec {
  std::int64_t by_us = 0;     ///< from 1 to the source's period: releases stay in order
  std::int64_t every_us = 0;  ///< least distance of two that are urgent, at least the period
  /// Module that hears of the source, and says when its chain has ended: what it publishes is urgent, what came before is
  /// not. Empty: the source's driver says, and all is.
  std::string marked_by = {};
  bool operator==(const UrgentSpec&) const = default;
};

/// A sensor. Its k-th release is in [offset + k period, offset + k period + jitter].
struct SourceSpec {
  std::string name;  ///< its topic
  Period period;
  std::int64_t offset_us = 0;
  std::int64_t jitter_us = 0;
  int clock = 0;  ///< index into AppSpec::clocks
  /// In a profile alone: the program publishes. `period` is then the least distance that it states;
  /// no grid is known.
  bool pushed = false;
  std::optional<UrgentSpec> urgent = {};  ///< nullopt: no release is
  bool operator==(const SourceSpec&) const = default;
};

/// What is said of an XModule beyond the XNodes that name it.
struct ModuleSpec {
  std::string name;
  /// Activations that may be inside at once: activation n enters when n - max_in_flight has left.
  std::int64_t max_in_flight = 1;
  bool optional = false;  ///< may be off in a degraded mode
  std::string host = {};  ///< of Platform::hosts, on which it has to be; empty: the solver chooses
  bool operator==(const ModuleSpec&) const = default;
};

/// End to end, from a source to an XNode. The worst of all paths, through edges and samples.
struct ChainSpec {
  std::string name;
  int from = -1;  ///< index into AppSpec::sources
  int to = -1;    ///< index into AppSpec::xnodes
  std::optional<std::int64_t> deadline_us = {};
  std::int64_t weight = 1;
  bool operator==(const ChainSpec&) const = default;
};

/// What a message along an edge costs between two types of XPU, beyond the WCETs. A time that
/// passes; it occupies no XPU.
struct TransferSpec {
  int edge = -1;  ///< index into AppSpec::edges
  std::string from_type, to_type;
  std::int64_t transfer_us = 0;
  bool operator==(const TransferSpec&) const = default;
};

/// What a program asks of its app beyond the graph (App::deadline, App::clock); a profile has it, and app.json
/// begins with it.
struct ProgramAsks {
  std::vector<ClockSpec> clocks = {{"main", 0}};  ///< SourceSpec::clock counts these
  std::optional<std::int64_t> deadline_us = {};   ///< of every chain that has none of its own
  std::vector<ChainSpec> chains = {};  ///< each with a deadline, without a name; a pair once
  [[nodiscard]] bool nothing() const { return *this == ProgramAsks{}; }
  bool operator==(const ProgramAsks&) const = default;
};

struct AppSpec {
  std::string name;
  /// No source has a rate (each has kNoRate): they release together, and again when all of that has ended.
  bool one_at_a_time = false;
  std::vector<XNodeSpec> xnodes;
  /// Indices into `xnodes`: first must finish before second starts. The whole precedence relation.
  std::vector<std::pair<int, int>> edges;
  std::optional<std::int64_t> deadline_us;  ///< of every chain that has none of its own
  std::vector<SourceSpec> sources = {};
  std::vector<ClockSpec> clocks = {{"main", 0}};  ///< the first is always "main"
  std::vector<ModuleSpec> modules = {};           ///< every module that an XNode names, once
  /// (u, v): v reads the newest finished result of u when it starts, and waits for nobody.
  std::vector<std::pair<int, int>> samples = {};
  std::vector<ChainSpec> chains = {};  ///< the readers fill it in where the file has none
  std::vector<TransferSpec> transfers = {};
  /// [sample] for how long its result is on its way once u has ended; empty: no time. In memory alone: of an app
  /// that is spread over hosts (solver/keys/hosts.h).
  std::vector<std::int64_t> sample_us = {};
  /// Why the profile that it was made from ended early; empty: it did not, or nobody has made one.
  std::string incomplete = {};

  [[nodiscard]] int find(std::string_view xnode) const;  ///< index or -1
  [[nodiscard]] std::size_t rates() const;               ///< different periods of its sources
  /// [xnode] how often it runs: the longest period among the sources that it hears of, itself or
  /// through others, since a join waits for the slowest; 0: not known.
  [[nodiscard]] std::vector<std::int64_t> periods() const;
  [[nodiscard]] std::vector<std::vector<int>> predecessors() const;
  [[nodiscard]] std::vector<std::vector<int>> successors() const;
  /// A topological order, smallest index first among equals; shorter than `xnodes` iff there is a
  /// cycle.
  /// `order`: pairs that count as edges.
  [[nodiscard]] std::vector<int> topological_order(
      const std::vector<std::pair<int, int>>& order = {}) const;
  [[nodiscard]] bool has_deadlines() const;  ///< some chain has one
  bool operator==(const AppSpec&) const = default;

  /// 64-bit FNV-1a over the canonical text of all that a certificate or a chain's claim depends on, as 16 hex digits. A
  /// policy carries it, so that a stale policy is refused rather than run.
  [[nodiscard]] std::string hash() const;
};

inline constexpr std::size_t kMaxXNodes = 20'000;
inline constexpr std::size_t kMaxEdges = 2'000'000;
inline constexpr std::size_t kMaxNameBytes = 256;
/// Why `name` is none: longer than kMaxNameBytes, a control character (C0, DEL, and C1, which some
/// terminals obey), bytes that are no UTF-8. Empty: it is one.
[[nodiscard]] std::string fault_of_name(const std::string& name);
inline constexpr std::size_t kMaxSources = 4096;
inline constexpr std::size_t kMaxAppChains = 20'000;
inline constexpr std::size_t kMaxSamples = 200'000;
inline constexpr std::size_t kMaxTransfers = 2'000'000;
inline constexpr std::size_t kMaxVariants = 64;              ///< of one XNode
inline constexpr std::size_t kMaxBeside = 256;               ///< of one XNode
inline constexpr std::int64_t kMaxMemoryKb = 1'000'000'000;  ///< a TB: sums of all instances fit
inline constexpr std::int64_t kMaxMessageBytes = 1'000'000'000;
inline constexpr std::int64_t kMaxWeight = 1000;
inline constexpr std::int64_t kMaxInFlight = 1000;
inline constexpr std::int64_t kMaxPpm = 100'000;  ///< a tenth: periods stay above 0
inline constexpr std::int64_t kDefaultPpm = 100;  ///< of every clock but "main"
inline constexpr const char* kMainClock = "main";
/// As an end of a chain in app.json: every source, or every XNode of ends_of() (loss.h). No name of one.
inline constexpr const char* kEveryEnd = "*";

/// Names unique and not empty, periods in [1, kMaxPeriodUs].
[[nodiscard]] Status validate(const std::vector<SourceSpec>& sources);
/// What an XNode hears of: sources of the app, each once, and none behind a predecessor.
[[nodiscard]] Status validate_heard(const std::vector<int>& heard, std::size_t sources,
                                    bool has_predecessor, const std::string& where);
/// Names unique and non-empty, an implementation for every XNode, WCETs in [1, kMaxTimeUs].
[[nodiscard]] Status validate_xnodes(const AppSpec& app);
/// Sources and XNodes as above, edges in range, no self edge, no duplicate edge, no cycle (the
/// message names the XNodes of one cycle). What a plan of one release needs to know.
[[nodiscard]] Status validate_graph(const AppSpec& app);
/// The same, and what model/periodic.h says.
[[nodiscard]] Status validate(const AppSpec& app);
/// Every XNode has an implementation for a type that the platform has an instance of, and all of
/// them one after the other, each on its slowest and paying for a preemption, end by kMaxTimeUs: a
/// time of any policy then fits into its file.
[[nodiscard]] Status validate_on(const AppSpec& app, const Platform& platform);

}  // namespace xauto
