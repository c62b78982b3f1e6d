// SPDX-License-Identifier: Apache-2.0
// Apps of several rates to measure by: perception stacks drawn at random. The same kind and seed give
// the same app on every machine, since nothing is computed in floating point.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"

namespace xauto::bench {

/// What is hard about a case.
enum class Kind : std::uint8_t {
  kRates,       ///< one clock, rates from 10 to 100 Hz that come round after at most a second
  kPipelined,   ///< one rate, faster than a release takes: several activations in flight
  kClocks,      ///< two or three clocks that drift
  kLong,        ///< periods whose hyperperiod has more than 100 000 jobs, or does not fit
  kAutomotive,  ///< many short XNodes on CPUs, from 1 ms to 1 s: thousands of jobs
  kMixed,       ///< rates, clocks, jitter, flights and feedback at once
  kOverload,    ///< more load than all XPUs together take: no policy keeps up
  kPublic,      ///< models that others have published (public_models.cc)
  kScale,       ///< hundreds of XNodes
};
[[nodiscard]] const char* to_string(Kind kind);

struct RatedCase {
  std::string name;  ///< "clocks-3"
  Kind kind = Kind::kRates;
  std::uint64_t seed = 0;
  /// Load of the platform in percent, if every XNode could be split among its types at best:
  /// load_ppm() / 10 000 of what was aimed at.
  int load_pct = 0;
  AppSpec app;
  Platform platform;
};

/// `load_pct` is what WCETs are scaled to. Valid by construction; checked again by validate().
[[nodiscard]] RatedCase make_case(Kind kind, std::uint64_t seed, int load_pct);

/// The engine control of WATERS 2015: 85 XNodes, more than 8 000 jobs a second.
[[nodiscard]] RatedCase engine_case(std::uint64_t seed, int load_pct);
/// The autonomous driving of the WATERS Challenge 2019: 18 XNodes, 8 349 jobs in 13.2 s.
[[nodiscard]] RatedCase waters_2019();
/// So many XNodes of each period, in components of at most 25, and a sample from each component to
/// the next of two.
struct Share {
  Period period;
  int xnodes = 0;
};
[[nodiscard]] RatedCase scale_case(const std::string& name, const std::vector<Share>& shares,
                                   int load_pct);

/// 55 cases: loads of 40 to 90 %, four of overload, and three that others have published. From
/// another `first` seed: cases of the same kinds that nothing was tuned on.
[[nodiscard]] std::vector<RatedCase> standard_set(std::uint64_t first = 1);
/// 300 XNodes of five rates; 1 000 XNodes with 50 000 jobs a hyperperiod, and as an overload.
[[nodiscard]] std::vector<RatedCase> scale_set();

/// The largest of sum_i min_t w_t C_it / (T_i |t|) over weights w of the types that sum to 1, on a
/// grid of 1/64, in millionths. It is a bound: above 1 000 000 no policy keeps up. At most three
/// types.
[[nodiscard]] std::int64_t load_ppm(const AppSpec& app, const Platform& platform);

}  // namespace xauto::bench
