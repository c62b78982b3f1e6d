// SPDX-License-Identifier: Apache-2.0
// Random numbers that are the same on every machine: SplitMix64 (Steele, Lea, Flood 2014, "Fast
// splittable pseudorandom number generators"). The standard library's distributions differ between
// implementations.
#pragma once

#include <cstdint>

namespace xauto::solver {

/// What a run's seed is multiplied by: those of its threads and turns lie within so many.
inline constexpr std::uint64_t kSeedsOfRun = 1'000'003;

class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  std::uint64_t next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }
  /// Uniform in [0, bound); the bias is below bound / 2^32, which no search notices. bound < 2^32.
  std::uint64_t below(std::uint64_t bound) { return ((next() >> 32) * bound) >> 32; }
  /// Uniform in (0, 1].
  double unit() { return (static_cast<double>(next() >> 11) + 1.0) * 0x1p-53; }

 private:
  std::uint64_t state_;
};

}  // namespace xauto::solver
