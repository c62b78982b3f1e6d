// SPDX-License-Identifier: Apache-2.0
// What Nsight Systems recorded, out of `nsys export --type sqlite`. Tables and columns: NVIDIA, "SQLite Export Schema
// Reference", https://docs.nvidia.com/nsight-systems/2021.5/nsys-exporter/exported_data.html, and its examples beside it
// (common_examples.html: a globalTid holds process and thread, correlationId joins an API call and what it triggered).
// Newer exports have more columns and tables, of which CUPTI_ACTIVITY_KIND_GRAPH_TRACE is read. Nothing there names a
// table of DLA tasks: each real table with DLA in its name and with `start` and `end` is taken for one.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"

namespace xauto::import {

/// An NVTX range of one thread, ns.
struct NsightRange {
  std::string name;  ///< with its domain, "TensorRT:enqueue"
  std::int64_t start_ns = 0, end_ns = 0;
  std::int64_t thread = 0;  ///< globalTid
};

/// A call of CUDA's API.
struct NsightCall {
  std::int64_t start_ns = 0, end_ns = 0, thread = 0;
  std::int64_t correlation = 0;
  bool waits = false;  ///< for the GPU, by its name
};

/// What an XPU did.
struct NsightWork {
  bool dla = false;         ///< else a kernel, a copy, a memset or a graph on a GPU
  std::int64_t device = 0;  ///< of GPUs
  std::int64_t start_ns = 0, end_ns = 0;
  std::int64_t process = 0;      ///< as process_of(); -1: the table does not say
  std::int64_t correlation = 0;  ///< 0: the table does not say
  std::int64_t thread = 0;       ///< that asked for it; 0: the table does not say
};

struct NsightTrace {
  std::vector<NsightRange> ranges;
  std::vector<NsightCall> calls;
  std::vector<NsightWork> work;
  std::vector<std::string> notes;  ///< what was missing, damaged or not understood, a line each
};

inline constexpr std::size_t kMaxNsightRows = 10'000'000;  ///< of a table
inline constexpr std::size_t kMaxRangeNames = 100'000;
inline constexpr std::int64_t kMaxNsightNs = 1'000'000'000'000'000'000;

/// The part of a globalTid that all threads of a process share.
[[nodiscard]] constexpr std::int64_t process_of(std::int64_t global_tid) {
  return global_tid >> 24;
}

/// What is damaged is left from there on, table by table. Errors: no SQLite file; no NVTX range.
[[nodiscard]] Result<NsightTrace> read_nsight(const std::string& path);

struct NsightOptions {
  std::string name;             ///< of the app
  std::string from;             ///< Seen::from
  std::int64_t margin_pct = 0;  ///< WCET: the longest time that was seen, and so much more
};

/// `lines`: for people, what was made of it and what was left out. Pure. Errors: no range came three times.
[[nodiscard]] Result<ImportedApp> nsight_app(const NsightTrace& trace, const NsightOptions& options,
                                             std::vector<std::string>& lines);

}  // namespace xauto::import
