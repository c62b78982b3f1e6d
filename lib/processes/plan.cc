// SPDX-License-Identifier: Apache-2.0
#include "processes/plan.h"

#include <algorithm>
#include <set>
#include <string>

#include "transport/shm_topic.h"

namespace xauto::runtime {

int Plan::Remote::reader(int process) const {
  const auto at = std::find(readers.begin(), readers.end(), process);
  return at == readers.end() ? -1 : static_cast<int>(at - readers.begin());
}

bool Plan::heard_here(const Graph::Topic& topic) const {
  return std::ranges::any_of(topic.subscribers, [this](const Graph::Subscriber& s) {
    return process_of[static_cast<std::size_t>(s.module)] != kElsewhere;
  });
}

namespace {

/// A module is where the policy has its XNodes.
void take_hosts(const Graph& graph, const Session& session, Plan& plan) {
  const int here = session.platform.find_host(session.host.name);
  for (std::size_t m = 0; m < graph.modules.size(); ++m) {
    const int xnode = session.app.find(
        graph.nodes[static_cast<std::size_t>(graph.modules[m].nodes.front())].name);
    const int xpu = session.keys->placements[static_cast<std::size_t>(xnode)].xpu;
    plan.host_of.push_back(session.platform.xpus[static_cast<std::size_t>(xpu)].host);
    if (plan.host_of.back() != here) plan.process_of[m] = Plan::kElsewhere;
  }
}

}  // namespace

bool Plan::comes_in(const Graph::Topic& topic) const {
  return topic.module >= 0 && process_of[static_cast<std::size_t>(topic.module)] == kElsewhere &&
         heard_here(topic);
}

Result<Plan> Plan::make(const Graph& graph, const detail::AppSpecErased& app,
                        const Session& session) {
  Plan plan;
  plan.process_of.assign(graph.modules.size(), 0);
  plan.topics.resize(graph.topics.size());
  plan.processes = static_cast<int>(session.parts.modules.size()) + 1;
  if (session.parts.modules.size() >= kMaxProcesses)
    return fail(ErrorCode::kInvalid,
                "has " + std::to_string(session.parts.modules.size()) + " processes, at most " +
                    std::to_string(kMaxProcesses - 1) + " are possible",
                "app '" + graph.name + "'");
  for (std::size_t p = 0; p < session.parts.modules.size(); ++p)
    for (const std::string& name : session.parts.modules[p]) {
      const auto module = std::find_if(graph.modules.begin(), graph.modules.end(),
                                       [&](const Graph::Module& m) { return m.name == name; });
      if (module == graph.modules.end())
        return fail(ErrorCode::kInvalid, "is not a module of the program",
                    "XModule '" + name + "'");
      int& process = plan.process_of[static_cast<std::size_t>(module - graph.modules.begin())];
      if (process != 0)
        return fail(ErrorCode::kInvalid, "is given to two processes", "XModule '" + name + "'");
      process = static_cast<int>(p) + 1;
    }
  if (session.host.there()) take_hosts(graph, session, plan);
  for (std::size_t t = 0; t < graph.topics.size(); ++t) {
    const Graph::Topic& topic = graph.topics[t];
    Remote& remote = plan.topics[t];
    remote.publisher =
        topic.module < 0 ? 0 : plan.process_of[static_cast<std::size_t>(topic.module)];
    std::set<int> readers;
    for (const Graph::Subscriber& s : topic.subscribers)
      readers.insert(plan.process_of[static_cast<std::size_t>(s.module)]);
    for (const detail::ObserverSpec& observer : app.observers)
      if (observer.topic.name == topic.spec.name) readers.insert(0);
    if (session.releases.record_outputs && topic.spec.encode != nullptr) readers.insert(0);
    readers.erase(remote.publisher);
    readers.erase(kElsewhere);  // what crosses is no shared memory's
    if (remote.publisher == kElsewhere) readers.clear();
    remote.readers.assign(readers.begin(), readers.end());
    if (remote.readers.empty()) continue;
    if (remote.readers.size() > transport::kMaxTopicSubscribers)
      return fail(ErrorCode::kInvalid,
                  "is read by " + std::to_string(remote.readers.size()) + " processes, at most " +
                      std::to_string(transport::kMaxTopicSubscribers) + " are possible",
                  "topic '" + topic.spec.name + "'");
    if (topic.spec.plain_bytes == 0 &&
        (topic.spec.encode == nullptr || topic.spec.decode == nullptr))
      return fail(ErrorCode::kInvalid,
                  "messages of type " + topic.spec.type_name + " cannot leave their process",
                  "topic '" + topic.spec.name + "'",
                  "specialise xauto::Codec for it, or keep its modules in one process");
  }
  return plan;
}

BoardShape shape_of(const Plan& plan, const Graph& graph, const Session& session,
                    std::size_t flows) {
  std::size_t parameters = 0;
  for (const Graph::Module& module : graph.modules) parameters += module.parameters.size();
  return {static_cast<std::uint32_t>(plan.processes),
          static_cast<std::uint32_t>(graph.modules.size()),
          static_cast<std::uint32_t>(graph.nodes.size()),
          static_cast<std::uint32_t>(flows),
          static_cast<std::uint32_t>(parameters),
          static_cast<std::uint32_t>(session.tables ? session.tables->scenarios.size() : 0),
          static_cast<std::uint32_t>(session.platform.xpus.size()),
          static_cast<std::uint32_t>(std::ranges::count_if(
              graph.topics, [&](const Graph::Topic& topic) { return plan.comes_in(topic); }))};
}

}  // namespace xauto::runtime
