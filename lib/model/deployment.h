// SPDX-License-Identifier: Apache-2.0
// Deployment: how an app is run, beside what runs where (policy.json): processes, restarts,
// overload, budgets, hangs, matching of inputs, chains with deadlines. File: deployment.json.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/keys.h"
#include "model/parameter.h"
#include "model/topic_transport.h"

namespace xauto {

/// What becomes of an activation whose XNode has run past its hang limit.
enum class OnHang : std::uint8_t {
  kLog,      ///< counted and reported, nothing else
  kDrop,     ///< given up: downstream is told, the module takes nothing until exec returns
  kRestart,  ///< the module's process is killed, and started again as `restarts` says
};
[[nodiscard]] const char* to_string(OnHang action);

/// What becomes of a message that comes while its module is not free.
struct Overload {
  enum class Kind : std::uint8_t {
    kNewest,  ///< it waits, and replaces one that waited before it
    kQueue,   ///< up to `depth` of them wait, in order; then the oldest is lost
    kSkip,    ///< it is lost: only a module that is free takes a release
  } kind = Kind::kNewest;
  std::uint32_t depth = 1;

  /// "newest", "skip", "queue:N" with N from 1 to 256.
  [[nodiscard]] static Result<Overload> parse(const std::string& text);
  [[nodiscard]] std::string to_string() const;
  bool operator==(const Overload&) const = default;
};

/// What is said of one XModule; of all others in `Deployment::defaults`.
struct ModuleDeployment {
  std::optional<bool> isolate;         ///< in a process of its own
  std::optional<std::string> process;  ///< with all modules of this name; excludes isolate
  std::optional<std::int64_t> restarts;
  std::optional<Overload> overload;
  std::optional<std::int64_t> budget_pct;  ///< budget of its XNodes in percent of their WCET
  std::optional<std::int64_t> hang_pct;    ///< hang limit in percent of the WCET
  std::optional<std::int64_t> hang_us;     ///< ... or as it is; excludes hang_pct
  std::optional<OnHang> on_hang;
  /// Several rates: inputs belong together when their origins are at most so far apart; missing:
  /// the newest of each.
  std::optional<std::int64_t> match_us;
  /// Of one module, not of the defaults; the program that declares them checks them.
  std::map<std::string, ParameterValue, std::less<>> parameters = {};
  /// Topic as the program calls it -> topic; likewise.
  std::map<std::string, std::string, std::less<>> remap = {};
  bool operator==(const ModuleDeployment&) const = default;
};

/// From a sensor's topic to a module that (indirectly) reads it.
struct ChainDeployment {
  std::string name, from, to;
  std::optional<std::int64_t> deadline_us;  ///< origin to publish
  std::optional<std::int64_t> max_age_us;   ///< origin to the publish of the next output
  bool operator==(const ChainDeployment&) const = default;
};

/// Of a run with tables: when it goes back to a scenario below the one in force.
struct TablesDeployment {
  std::optional<std::int64_t> dwell_us;    ///< not before so long; 2 000 000
  std::optional<std::int64_t> margin_pct;  ///< jobs stay so much below what that scenario allows; 0
  bool operator==(const TablesDeployment&) const = default;
};

struct Deployment {
  std::string app;                                ///< AppSpec::name
  std::optional<std::int64_t> queue_depth, keep;  ///< of topics between processes
  ModuleDeployment defaults;
  /// Name -> XModule of the program that runs under it; one that has any runs under these alone.
  std::map<std::string, std::string, std::less<>> instances = {};
  std::map<std::string, ModuleDeployment, std::less<>> modules;
  std::map<std::string, std::int64_t, std::less<>> budgets_us;  ///< XNode -> its budget
  std::vector<ChainDeployment> chains;
  std::map<std::string, TopicTransport, std::less<>> transport;  ///< topic -> where it goes
  TablesDeployment tables;
  bool operator==(const Deployment&) const = default;

  /// What holds for one module: what is said of it, else what is said of all.
  [[nodiscard]] ModuleDeployment of(std::string_view module) const;
  /// Modules by process, in the order of the app; those of the hub are not listed.
  [[nodiscard]] std::vector<std::vector<std::string>> processes(const AppSpec& app) const;
};

inline constexpr std::size_t kMaxChains = 256;
inline constexpr std::size_t kMaxInstances = 4096, kMaxRemaps = 4096;  ///< of one module
inline constexpr std::size_t kMaxTransports = 256;
inline constexpr std::int64_t kMaxBudgetPct = 1'000'000;
inline constexpr std::int64_t kMaxDwellUs = 3'600'000'000, kMaxMarginPct = 90;

/// `origin` names the text in messages. Checked against `app`: its name, modules and XNodes.
[[nodiscard]] Result<Deployment> parse_deployment(std::string_view text, std::string_view origin,
                                                  const AppSpec& app, Keys* keys = nullptr);
[[nodiscard]] Result<Deployment> load_deployment(const std::string& path, const AppSpec& app);
/// Before there is an app.json: names are not checked.
[[nodiscard]] Result<Deployment> parse_deployment(std::string_view text, std::string_view origin);
[[nodiscard]] Result<Deployment> load_deployment(const std::string& path);
[[nodiscard]] std::string to_json(const Deployment& deployment);

}  // namespace xauto
