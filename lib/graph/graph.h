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
    int input = -1;        ///< index into that module's inputs, then samples
    bool sampled = false;  ///< reads the newest when it begins; not fired by it
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
    std::vector<int> nodes;                           ///< in chain order
    std::vector<int> inputs;                          ///< topics
    std::vector<int> outputs;                         ///< topics, as spec->outputs
    bool sink = false;                                ///< its outputs fire no other module
    std::vector<int> samples;                         ///< topics, as spec->samples
    std::vector<detail::ParameterHandle> parameters;  ///< its own and its XNodes'
    /// [sample] sources whose origins come through it, a bit each: a way that has come round is no
    /// chain (model/onward.h, docs/runtime.md).
    std::vector<std::uint32_t> sample_origins;
    int component = -1;  ///< modules that fire each other, directly or through others
    /// Activation k stems from release k of each source of the component.
    bool numbered = true;
  };

  std::string name;
  std::vector<SourceSpec> sources;  ///< as the App's
  ProgramAsks asks = {};
  std::vector<int> topic_of_source;  ///< [source]
  std::vector<Node> nodes;
  std::vector<Module> modules;
  std::vector<Topic> topics;
  std::vector<int> module_order;           ///< topological
  std::vector<std::pair<int, int>> edges;  ///< between nodes: chains, then topics
  std::vector<std::pair<int, int>>
      samples;  ///< nodes (u, v): v's module samples what u's publishes
  int components = 0;
  /// All sources have one period, and none of several is pushed: activation k of every module stems
  /// from release k of every sensor.
  bool single_rate = true;
  /// A result may stem from different releases of its sources: messages carry an origin per source.
  bool tells_origins = false;

  /// Errors: everything that is wrong at once, a line each, with the names involved (kInvalid).
  [[nodiscard]] static Result<Graph> build(const detail::AppSpecErased& app);

  /// The modules of this one's component put their inputs together by age, not by number.
  void match_by_origin(int module);

  /// The same XNodes, modules, edges and samples as `app` says, or what differs.
  [[nodiscard]] Status matches(const AppSpec& app) const;

 private:
  [[nodiscard]] Status same_pairs(const std::vector<std::pair<int, int>>& ours,
                                  const std::vector<std::pair<int, int>>& theirs,
                                  const std::string& what, const AppSpec& app) const;
};

/// The implementation of `node`, or of its variant, for XPUs of `type`; or null.
[[nodiscard]] const detail::ImplSpec* find_impl(const detail::XNodeSpecErased& node,
                                                const std::string& type,
                                                const std::string& variant = {});

/// "gpu0" with its type and its index among the instances of that type.
[[nodiscard]] XpuId xpu_id(const Platform& platform, int xpu);

}  // namespace xauto::runtime
