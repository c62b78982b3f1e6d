// SPDX-License-Identifier: Apache-2.0
// The tracing programs (bpf/xauto_trace.bpf.c) on one run's XNode threads, for as long as the
// object lives, whoever schedules. On a kernel without BTF by its tracepoints' formats; then threads in PID namespaces of
// their own are not seen.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <uapi/xauto/bpf.h>

#include <xauto/result.h>

#include "kernel/run_maps.h"

namespace xauto::kernel {

struct TracerOptions {
  /// Size of the ring buffer; rounded up to a power of two of pages.
  std::uint32_t ring_bytes = 1u << 20;
  /// false: histograms only, all that `xauto top` shows.
  bool events = true;
  /// Pin "events", "pipe", "hist", "cpus" and "losses" below the run's folder.
  bool pin = true;
};

class Tracer {
 public:
  [[nodiscard]] static Result<Tracer> attach(const RunMaps& maps, const TracerOptions& options);
  Tracer(Tracer&&) noexcept;
  ~Tracer();

  /// Hands over the events that are there; waits at most `timeout_ms` for the first one. Returns
  /// how many there were.
  [[nodiscard]] Result<std::size_t> read(int timeout_ms,
                                         const std::function<void(const xauto_bpf_event&)>& sink);
  [[nodiscard]] xauto_bpf_losses losses() const;
  [[nodiscard]] std::vector<xauto_bpf_hist> histograms() const;  ///< by XNode
  [[nodiscard]] std::vector<xauto_bpf_cpu> cpus() const;         ///< by CPU

 private:
  Tracer();
  struct Attached;
  std::unique_ptr<Attached> attached_;
};

/// The value below which `permille` of a histogram's counts lie, in us: the upper edge of its
/// bucket.
[[nodiscard]] std::uint64_t quantile_us(const __u64 (&buckets)[XAUTO_BPF_BUCKETS], int permille);

}  // namespace xauto::kernel
