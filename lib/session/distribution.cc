// SPDX-License-Identifier: Apache-2.0
#include "session/distribution.h"

#include <algorithm>
#include <bit>

#include "base/quantile.h"

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
  if (exact_.size() + 1 == count_ && exact_.size() < kMaxExact) exact_.push_back(value);
  put(bucket_of(value), 1);
}

void Distribution::put(std::uint32_t bucket, std::uint64_t times) {
  if (buckets_.size() <= bucket) buckets_.resize(bucket + 1);
  buckets_[bucket] += times;
}

std::vector<std::int64_t> Distribution::exact() const {
  if (!has_all()) return {};
  return {exact_.begin(), exact_.end()};
}

std::map<std::uint32_t, std::uint64_t> Distribution::buckets() const {
  std::map<std::uint32_t, std::uint64_t> used;
  for (std::uint32_t b = 0; b < buckets_.size(); ++b)
    if (buckets_[b] != 0) used[b] = buckets_[b];
  return used;
}

void Distribution::merge(const Distribution& other) {
  if (other.has_all()) {
    for (const std::int64_t value : other.exact_) add(value);
    return;
  }
  for (std::uint32_t b = 0; b < other.buckets_.size(); ++b)
    if (other.buckets_[b] != 0) put(b, other.buckets_[b]);
  count_ += other.count_;
  sum_ += other.sum_;
  max_ = std::max(max_, other.max_);
}

std::int64_t Distribution::quantile(double q) const {
  if (count_ == 0) return 0;
  const std::uint64_t rank = nearest_rank(q, count_);
  if (has_all()) {
    std::vector<std::int64_t> sorted = exact();
    const auto at = sorted.begin() + static_cast<std::ptrdiff_t>(rank - 1);
    std::nth_element(sorted.begin(), at, sorted.end());
    return *at;
  }
  std::uint64_t seen = 0;
  for (std::uint32_t b = 0; b < buckets_.size(); ++b) {
    seen += buckets_[b];
    if (seen >= rank) return std::min(end_of(b), max_);
  }
  return max_;
}

bool Distribution::restore(std::vector<std::int64_t> exact,
                           const std::map<std::uint32_t, std::uint64_t>& buckets, std::int64_t sum,
                           std::int64_t max, Distribution& into) {
  if (exact.size() > kMaxExact || (!exact.empty() && !buckets.empty())) return false;
  for (const auto& [bucket, times] : buckets)
    if (bucket >= kBuckets || times > std::uint64_t{1} << 40) return false;
  into = {};
  for (const std::int64_t value : exact) into.put(bucket_of(value), 1);
  into.count_ = exact.size();
  for (const auto& [bucket, times] : buckets) {
    into.put(bucket, times);
    into.count_ += times;
  }
  into.sum_ = sum;
  into.max_ = max;
  into.exact_.assign(exact.begin(), exact.end());
  return true;
}

}  // namespace xauto::runtime
