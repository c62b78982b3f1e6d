// SPDX-License-Identifier: Apache-2.0
#include "grid/context.h"

#include <algorithm>

namespace xauto::runtime {

std::vector<char> sinks(const Graph& graph) {
  std::vector<char> sinks;
  for (const Graph::Module& module : graph.modules) {
    const auto fires = [&](int topic) {
      const auto& readers = graph.topics[static_cast<std::size_t>(topic)].subscribers;
      return std::ranges::any_of(readers, [](const Graph::Subscriber& s) { return !s.sampled; });
    };
    sinks.push_back(std::ranges::none_of(module.outputs, fires) ? 1 : 0);
  }
  return sinks;
}

}  // namespace xauto::runtime
