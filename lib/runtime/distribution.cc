// SPDX-License-Identifier: Apache-2.0
#include "runtime/distribution.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace xauto::runtime {
namespace {

constexpr int kBits = 6;  ///< 64 buckets per power of two
constexpr std::uint32_t kBuckets = (64 - kBits) << kBits;

}  // namespace

std::uint32_t Distribution::bucket_of(std::int64_t value) {
  const auto v = static_cast<std::uint64_t>(std::max<std::int64_t>(value, 0));
  const int shift = std::max(0, static_cast<int>(std::bit_width(v)) - kBits - 1);
  return (static_cast<std::uint32_t>(shift) << kBits) + static_cast<std::uint32_t>(v >> shift);
}

std::int64_t Distribution::end_of(std::uint32_t bucket) {
  if (bucket < 2u << kBits) return bucket;
  const std::uint32_t shift = (bucket >> kBits) - 1;
  const std::uint64_t top = (bucket & ((1u << kBits) - 1)) | 1u << kBits;
  return static_cast<std::int64_t>(((top + 1) << shift) - 1);
}

void Distribution::add(std::int64_t value) {
  value = std::max<std::int64_t>(value, 0);
  ++count_;
  sum_ += value;
  max_ = std::max(max_, value);
  if (buckets_.empty() && exact_.size() < kMaxExact) {
    exact_.push_back(value);
    return;
  }
  for (const std::int64_t old : exact_) ++buckets_[bucket_of(old)];
  exact_.clear();
  exact_.shrink_to_fit();
  ++buckets_[bucket_of(value)];
}

void Distribution::merge(const Distribution& other) {
  for (const std::int64_t value : other.exact_) add(value);
  if (other.buckets_.empty()) return;
  for (const std::int64_t old : exact_) ++buckets_[bucket_of(old)];
  exact_.clear();
  for (const auto& [bucket, count] : other.buckets_) buckets_[bucket] += count;
  count_ += other.count_;
  sum_ += other.sum_;
  max_ = std::max(max_, other.max_);
}

std::int64_t Distribution::quantile(double q) const {
  if (count_ == 0) return 0;
  const auto rank = std::clamp<std::uint64_t>(
      static_cast<std::uint64_t>(std::ceil(q * static_cast<double>(count_))), 1, count_);
  if (buckets_.empty()) {
    std::vector<std::int64_t> sorted = exact_;
    const auto at = sorted.begin() + static_cast<std::ptrdiff_t>(rank - 1);
    std::nth_element(sorted.begin(), at, sorted.end());
    return *at;
  }
  std::uint64_t seen = 0;
  for (const auto& [bucket, count] : buckets_) {
    seen += count;
    if (seen >= rank) return std::min(end_of(bucket), max_);
  }
  return max_;
}

bool Distribution::restore(std::vector<std::int64_t> exact,
                           std::map<std::uint32_t, std::uint64_t> buckets, std::int64_t sum,
                           std::int64_t max, Distribution& into) {
  if (exact.size() > kMaxExact || (!exact.empty() && !buckets.empty())) return false;
  into.count_ = exact.size();
  for (const auto& [bucket, count] : buckets) {
    if (bucket >= kBuckets || count > std::uint64_t{1} << 40) return false;
    into.count_ += count;
  }
  into.sum_ = sum;
  into.max_ = max;
  into.exact_ = std::move(exact);
  into.buckets_ = std::move(buckets);
  return true;
}

}  // namespace xauto::runtime
