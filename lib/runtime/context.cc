// SPDX-License-Identifier: Apache-2.0
#include "runtime/context.h"

#include <algorithm>

namespace xauto::runtime {

OfTables modules_off(const Session& session, const Graph& graph) {
  OfTables off;
  // By keys it is no number of a release that says which table it has: each module tells what it left out.
  if (session.tables_of_keys()) return {std::vector<char>(graph.modules.size(), 0)};
  for (std::size_t t = 0; t < session.num_tables(); ++t) {
    auto& row = off.emplace_back();
    for (const Graph::Module& module : graph.modules)
      row.push_back(session.tables && session.tables->tables[t].loss.is_off(module.name) ? 1 : 0);
  }
  return off;
}

OfTables sinks(const OfTables& off, const Graph& graph) {
  OfTables sinks;
  for (const std::vector<char>& off_here : off) {
    auto& row = sinks.emplace_back();
    for (std::size_t m = 0; m < graph.modules.size(); ++m) {
      const auto fires = [&](int topic) {
        const auto& readers = graph.topics[static_cast<std::size_t>(topic)].subscribers;
        return std::any_of(readers.begin(), readers.end(), [&](const Graph::Subscriber& s) {
          return !s.sampled && off_here[static_cast<std::size_t>(s.module)] == 0;
        });
      };
      const std::vector<int>& outputs = graph.modules[m].outputs;
      row.push_back(off_here[m] == 0 && std::none_of(outputs.begin(), outputs.end(), fires) ? 1
                                                                                            : 0);
    }
  }
  return sinks;
}

}  // namespace xauto::runtime
