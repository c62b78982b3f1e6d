// SPDX-License-Identifier: Apache-2.0
// Attacks a policy of keys: looks for an execution in which a job ends after its key, or a chain
// takes longer than its claim. Simulates the rule of docs/keys.md with code of its own, and
// climbs: execution times up to the WCETs, jitter, phases between clocks and their drift. Where app.json states
// what an XNode takes beside loads, a job takes what it takes alone; when it meets a job on another XPU, be it for
// an instant, from then on all that is stated beside what it has met.
//
// What it finds is a counterexample. That it finds nothing proves nothing.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::attack {

/// Before its planned start a job may start early: by the rule, or by a wrong one that looks like it.
enum class Early {
  kByTheRule,
  kNever,
  kFromItsHold,  ///< wrong: it looks at the conditions before its hold alone, and not before its planned start
  kOfTheReleased,  ///< wrong: of the XPU's jobs of smaller keys, and of what it reads, what is released
  kByTheSequence,   ///< wrong: once those have ended that are planned to start before it
  kWithoutSamples,  ///< wrong: whatever it reads
  kOfItsXpu,        ///< wrong where WCETs are counted apart: whatever runs on other XPUs
  kOfItsApp,        ///< wrong where preemption costs: beside another app, as if it were alone
};

struct Options {
  std::int64_t jobs = 200'000;  ///< to simulate, all executions together
  std::uint64_t seed = 1;
  Early early = Early::kByTheRule;
  std::vector<int> app_of = {};  ///< as PlayOptions::app_of
};

struct Found {
  std::int64_t jobs = 0;
  std::int64_t executions = 0;
  std::string late;           ///< a job past its key, in words; empty: none
  std::string chain;          ///< a chain above its claim; empty: none
  double closest_us = -1e18;  ///< end - key of the latest job of all
  double fullest = 0;         ///< largest part of a chain's claim that was seen
  [[nodiscard]] bool broken() const { return !late.empty() || !chain.empty(); }
};

/// The app is one that the readers accept; ends early once something is broken.
[[nodiscard]] Found attack(const AppSpec& app, const Platform& platform, const Policy& policy,
                           const Options& options);

}  // namespace xauto::attack
