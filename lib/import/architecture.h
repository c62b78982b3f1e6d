// SPDX-License-Identifier: Apache-2.0
// CARET's architecture.yaml: what a person has said of a ROS 2 program. Its keys: tier4/CARET_doc, and the files that
// `ros2 caret create_architecture_file` writes.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

namespace xauto::import {

/// A callback as the file names it.
struct ArchitectureCallback {
  std::string name;   ///< "/node/callback_0"
  std::string node;   ///< "/node"
  std::string topic;  ///< of a subscription; empty: a timer
  std::int64_t period_ns = 0;
  std::string symbol;
};

struct ArchitecturePath {
  struct Step {
    std::string node, from_topic, to_topic;  ///< empty: UNDEFINED
  };
  std::string name;
  std::vector<Step> steps;
};

struct Architecture {
  std::vector<ArchitecturePath> paths;
  std::vector<ArchitectureCallback> callbacks;
  /// Names of callbacks of a node: the second uses what the first has left.
  std::vector<std::pair<std::string, std::string>> passings;
};

/// Errors: parse_yaml(); it is something else.
[[nodiscard]] Result<Architecture> parse_architecture(std::string_view text,
                                                      const std::string& origin);

}  // namespace xauto::import
