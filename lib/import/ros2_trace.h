// SPDX-License-Identifier: Apache-2.0
// What a ROS 2 program did, out of the events of ros2_tracing and of CARET. Tracepoints and their fields:
// ros2/ros2_tracing, tracetools/include/tracetools/tp_call.h and doc/design_ros_2.md (8.4.0);
// tier4/CARET_trace, CARET_trace/include/caret_trace/tp.h. Some distributions have fields that others lack:
// whatever is missing is 0, and is done without.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"

#include "import/ctf.h"

namespace xauto::import {

struct RosCallback {
  enum class Kind : std::uint8_t { kOther, kTimer, kSubscription, kService };
  Kind kind = Kind::kOther;
  std::string node;   ///< "/camera/driver"; empty: not known
  std::string topic;  ///< of a subscription
  std::string symbol;
  std::int64_t process = 0;
  std::int64_t period_ns = 0,
               made_ns = 0;  ///< of a timer: its first call is a period after it was made
  std::int64_t depth = 0;    ///< of a subscription's queue; 0: not known
  int group = -1;            ///< index into RosTrace::groups
};

/// A callback that ran.
struct RosCall {
  int callback = -1;
  std::int64_t start_ns = 0, end_ns = 0, thread = 0;
  std::uint64_t stamp = 0;        ///< of its message, when it was sent; 0: not known
  std::uint64_t header = 0;       ///< ... its header's stamp
  std::int64_t publication = -1;  ///< whose message fired it: index into RosTrace::publications
};

struct RosPublication {
  std::string topic;
  std::int64_t time_ns = 0;
  std::int64_t call = -1;  ///< during which; -1: during none
  std::uint64_t stamp = 0, header = 0;
};

struct RosGroup {
  bool reentrant = false;
  int executor = -1;  ///< index into RosTrace::executors
};

struct RosExecutor {
  std::string type;  ///< "multi_threaded_executor"; empty: nobody has told
  std::int64_t process = 0;
};

struct RosTrace {
  std::vector<RosCallback> callbacks;        ///< in the order in which they were made
  std::vector<RosCall> calls;                ///< by start
  std::vector<RosPublication> publications;  ///< by time
  std::vector<RosGroup> groups;
  std::vector<RosExecutor> executors;
  std::int64_t begin_ns = 0, end_ns = 0;
  int cpus = 0;                    ///< on which callbacks ran; 0: not known
  std::vector<std::string> notes;  ///< what was lost, damaged or not understood, a line each
};

/// Errors: read_ctf(); no callback ran.
[[nodiscard]] Result<RosTrace> read_ros2_trace(const std::string& folder);

/// The same of events that were read. Pure.
[[nodiscard]] Result<RosTrace> ros2_trace_of(const Trace& trace, const std::string& origin);

/// The events that are read, in the order of TraceEvent::kind.
[[nodiscard]] const std::vector<WantedEvent>& ros2_events();

}  // namespace xauto::import
