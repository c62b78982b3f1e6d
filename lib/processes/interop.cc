// SPDX-License-Identifier: Apache-2.0
#include "processes/interop.h"

#include <algorithm>

#include "base/clock.h"

namespace xauto::runtime {
namespace {

std::size_t largest(const detail::TopicSpec& spec) {
  return spec.plain_bytes > 0 ? spec.plain_bytes : spec.max_bytes;
}

}  // namespace

Result<std::unique_ptr<Interop>> Interop::open(const Graph& graph, const Plan& plan,
                                               const Session& session) {
  std::vector<std::size_t> out, in;
  transport::BridgeOptions options;
  for (const auto& [name, where] : session.deployment.transport) {
    const std::string place = "transport of topic '" + name + "'";
    const auto topic = std::find_if(graph.topics.begin(), graph.topics.end(),
                                    [&name = name](const auto& t) { return t.spec.name == name; });
    if (topic == graph.topics.end())
      return fail(ErrorCode::kInvalid, "the app has no such topic", place);
    const auto t = static_cast<std::size_t>(topic - graph.topics.begin());
    const bool feed = where.feed;
    if (feed && topic->source < 0)
      return fail(ErrorCode::kInvalid, "is published by a module, so it cannot be fed", place,
                  "\"cyclonedds\" lets others hear it; only topics of sources can be fed");
    if (feed && graph.sources[static_cast<std::size_t>(topic->source)].pushed)
      return fail(ErrorCode::kInvalid, "is pushed by the program, so it cannot be fed, too", place,
                  "add the source with a period and a function, or drop it here");
    if (feed && session.releases.lockstep)
      return fail(ErrorCode::kInvalid, "what comes from outside comes when it comes", place,
                  "run without --lockstep");
    if (feed && !session.releases.input.empty()) continue;  // the recording is the input
    if (plan.topics[t].publisher != session.parts.process) continue;
    (feed ? in : out).push_back(t);
    options.largest_bytes = std::max(options.largest_bytes, largest(topic->spec));
  }
  if (out.empty() && in.empty()) return nullptr;
  XAUTO_ASSIGN(options.domain, transport::ros_domain());
  auto interop = std::unique_ptr<Interop>(new Interop);
  XAUTO_ASSIGN(interop->bridge_, transport::open_bridge("cyclonedds", options));
  interop->publishers_.resize(graph.topics.size());
  interop->feeds_.resize(graph.topics.size());
  interop->replaced_ = std::vector<std::atomic<std::uint64_t>>(graph.topics.size());
  for (const Graph::Topic& topic : graph.topics) interop->names_.push_back(topic.spec.name);
  for (const std::size_t t : out) {
    const detail::TopicSpec& spec = graph.topics[t].spec;
    XAUTO_ASSIGN(interop->publishers_[t],
                 interop->bridge_->publish(spec, session.deployment.transport.at(spec.name).qos));
  }
  for (const std::size_t t : in) {
    const detail::TopicSpec& spec = graph.topics[t].spec;
    XAUTO_ASSIGN(interop->feeds_[t],
                 interop->bridge_->subscribe(spec, session.deployment.transport.at(spec.name).qos,
                                             interop->arrived_));
  }
  return interop;
}

Interop::~Interop() {
  stop();
}

Interop::Taken Interop::take(const std::vector<int>& topics, std::int64_t until_ns,
                             const std::atomic<bool>& stop) {
  Taken taken;
  auto& messages = taken.messages;
  messages.resize(topics.size());
  for (bool first = true;; first = false) {
    bool all = true;
    const std::int64_t looked_ns = now_ns();
    for (std::size_t i = 0; i < topics.size(); ++i) {
      if (auto newest = take(static_cast<std::size_t>(topics[i])); newest.message != nullptr) {
        if (messages[i].message != nullptr)
          replaced_[static_cast<std::size_t>(topics[i])].fetch_add(1);
        messages[i] = std::move(newest);
        if (!first) taken.came_ns = looked_ns;
      }
      all = all && messages[i].message != nullptr;
    }
    const std::int64_t now = now_ns();
    if (all || until_ns <= now || stop.load()) return taken;
    // Rung also for what was taken already, or is refused: then there is another round.
    wait(std::min(until_ns, now + kLookNs), [&] {
      return !stop.load() && std::none_of(topics.begin(), topics.end(), [&](int t) {
        return waits(static_cast<std::size_t>(t));
      });
    });
  }
}

detail::Envelope Interop::take(std::size_t topic) {
  detail::Envelope newest;
  while (auto envelope = feeds_[topic]->take()) {
    if (newest.message != nullptr) replaced_[topic].fetch_add(1);
    newest = std::move(*envelope);
  }
  return newest;
}

void Interop::stop() {
  if (bridge_) bridge_->stop();  // none: it could not be opened
}

std::vector<std::string> Interop::notes() const {
  std::vector<std::string> notes = bridge_->notes();
  for (std::size_t t = 0; t < feeds_.size(); ++t) {
    if (feeds_[t] == nullptr) continue;
    if (const auto n = feeds_[t]->replaced() + replaced_[t].load(); n > 0)
      notes.push_back("topic '" + names_[t] + "' from DDS: " + std::to_string(n) +
                      " messages were not used, a newer one came before a release took them");
  }
  return notes;
}

}  // namespace xauto::runtime
