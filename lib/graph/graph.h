// SPDX-License-Identifier: Apache-2.0
// The App as a graph, checked: modules, XNodes and topics as dense indices. The runtime and the
// profiler read this; `names` of XNodes are what app.json and policy.json call them.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "graph/app_spec.h"
#include "model/app.h"
#include "model/platform.h"

namespace xauto::runtime {

struct Graph {
  struct Node {
    std::string name;
    int module = -1;
    const detail::XNodeSpecErased* spec = nullptr;
    std::vector<int> sources = {};  ///< as XNodeSpec::sources
  };
  struct Subscriber {
    int module = -1;
    int input = -1;  ///< index into that module's inputs
  };
  struct Topic {
    detail::TopicSpec spec;
    int source = -1;  ///< index into sources, or
    int module = -1;  ///< the publishing module
    std::vector<Subscriber> subscribers;
  };
  struct Module {
    std::string name;
    const detail::XModuleSpec* spec = nullptr;
    std::vector<int> nodes;    ///< in chain order
    std::vector<int> inputs;   ///< topics
    std::vector<int> outputs;  ///< topics, as spec->outputs
    bool sink = false;         ///< no other module reads its outputs
  };

  std::string name;
  std::vector<SourceSpec> sources;   ///< as the App's
  std::vector<int> topic_of_source;  ///< [source]
  std::vector<Node> nodes;
  std::vector<Module> modules;
  std::vector<Topic> topics;
  std::vector<int> module_order;           ///< topological
  std::vector<std::pair<int, int>> edges;  ///< between nodes: chains, then topics
  /// All sources have one period, and none of several is pushed: activation k of every module stems
  /// from release k of every sensor.
  bool single_rate = true;

  /// Errors: everything that is wrong at once, a line each, with the names involved (kInvalid).
  [[nodiscard]] static Result<Graph> build(const detail::AppSpecErased& app);

  /// The same XNodes, modules and edges as `app` says, or what differs.
  [[nodiscard]] Status matches(const AppSpec& app) const;
};

/// The implementation of `node` for XPUs of `type`, or null.
[[nodiscard]] const detail::ImplSpec* find_impl(const detail::XNodeSpecErased& node,
                                                const std::string& type);

/// "gpu0" with its type and its index among the instances of that type.
[[nodiscard]] XpuId xpu_id(const Platform& platform, int xpu);

}  // namespace xauto::runtime
