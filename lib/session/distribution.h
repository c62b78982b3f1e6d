// SPDX-License-Identifier: Apache-2.0
// Many times in bounded memory: every value as long as there are few of them, and a histogram whose buckets are at most
// 1/64 wide. Count, sum and largest value are always exact. To add one takes the same time however many there are: whoever
// ends a release does it, before the next job.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <vector>

namespace xauto::runtime {

/// Threads: none of its own; the owner locks.
class Distribution {
 public:
  static constexpr std::size_t kMaxExact = 65'536;

  void add(std::int64_t value);
  void merge(const Distribution& other);
  /// Nearest rank; 0 without values. Beyond kMaxExact values at most 1/64 too large.
  [[nodiscard]] std::int64_t quantile(double q) const;
  [[nodiscard]] std::uint64_t count() const { return count_; }
  [[nodiscard]] std::int64_t max() const { return max_; }
  [[nodiscard]] std::int64_t mean() const {
    return count_ == 0 ? 0 : sum_ / static_cast<std::int64_t>(count_);
  }

  // For the way between processes: the values, in their order, as long as there are few, and always buckets with their
  // counts.
  [[nodiscard]] std::vector<std::int64_t> exact() const;
  [[nodiscard]] std::map<std::uint32_t, std::uint64_t> buckets() const;
  [[nodiscard]] std::int64_t sum() const { return sum_; }
  /// False: these numbers cannot come from a Distribution.
  [[nodiscard]] static bool restore(std::vector<std::int64_t> exact,
                                    const std::map<std::uint32_t, std::uint64_t>& buckets,
                                    std::int64_t sum, std::int64_t max, Distribution& into);

  /// Smallest values of their own bucket up to 64, then 64 buckets for each power of two.
  [[nodiscard]] static std::uint32_t bucket_of(std::int64_t value);
  /// The largest value of a bucket.
  [[nodiscard]] static std::int64_t end_of(std::uint32_t bucket);

 private:
  void put(std::uint32_t bucket, std::uint64_t times);
  [[nodiscard]] bool has_all() const { return exact_.size() == count_; }
  std::uint64_t count_ = 0;
  std::int64_t sum_ = 0, max_ = 0;
  std::deque<std::int64_t>
      exact_;  ///< the first kMaxExact, in pieces: a vector that grows copies all
  std::vector<std::uint64_t> buckets_;  ///< of all, up to the largest one in use
};

}  // namespace xauto::runtime
