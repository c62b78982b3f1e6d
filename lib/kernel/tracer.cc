// SPDX-License-Identifier: Apache-2.0
// The part that needs no libbpf.
#include "kernel/tracer.h"

namespace xauto::kernel {

std::uint64_t quantile_us(const __u64 (&buckets)[XAUTO_BPF_BUCKETS], int permille) {
  std::uint64_t total = 0;
  for (const __u64 count : buckets) total += count;
  if (total == 0) return 0;
  const std::uint64_t rank = (total * static_cast<std::uint64_t>(permille) + 999) / 1000;
  std::uint64_t seen = 0;
  for (int i = 0; i < XAUTO_BPF_BUCKETS; ++i) {
    seen += buckets[i];
    if (seen >= rank) return std::uint64_t{1} << (i + 1);
  }
  return std::uint64_t{1} << XAUTO_BPF_BUCKETS;
}

}  // namespace xauto::kernel
