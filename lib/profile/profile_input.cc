// SPDX-License-Identifier: Apache-2.0
#include "profile/profile_input.h"

#include <algorithm>
#include <string>
#include <utility>

#include "base/clock.h"
#include "base/log.h"
#include "record/xauto_msgs.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kPushNs = 10'000'000'000;  ///< patience with a driver

}  // namespace

Result<ProfileInput> ProfileInput::open(const detail::AppSpecErased& app, const Graph& graph,
                                        const Session& session, detail::Inlets& inlets) {
  ProfileInput input(app, graph, inlets);
  if (!session.releases.input.empty()) {
    XAUTO_ASSIGN(auto recording, record::Recording::open(session.releases.input));
    if (!recording.note().empty()) log::warn("{}", recording.note());
    input.recording_.emplace(std::move(recording));
    for (std::size_t t = 0; t < graph.topics.size(); ++t) {
      if (graph.topics[t].source < 0) continue;
      const auto& topics = input.recording_->topics();
      const auto at = std::find_if(topics.begin(), topics.end(), [&](const auto& topic) {
        return record::is_app_topic(topic, graph.topics[t].spec.name);
      });
      if (at == topics.end())
        return fail(ErrorCode::kInvalid,
                    "has no messages for topic '" + graph.topics[t].spec.name + "'",
                    session.releases.input);
    }
  }
  return input;
}

Result<bool> ProfileInput::next(Messages& messages) {
  thread_.check();
  const std::uint64_t sequence = sequence_++;
  if (!recording_) {
    for (std::size_t s = 0; s < app_->sources.size(); ++s) {
      auto& message = messages[static_cast<std::size_t>(graph_->topic_of_source[s])];
      message = app_->sources[s].inlet ? nullptr : app_->sources[s].make(sequence, nullptr);
    }
    XAUTO_TRY(wait_for_pushed(messages));
    return true;
  }
  std::size_t left = 0;
  for (std::size_t t = 0; t < graph_->topics.size(); ++t) {
    if (graph_->topics[t].source < 0) continue;
    messages[t].reset();
    ++left;
  }
  while (left > 0) {
    XAUTO_ASSIGN(auto message, recording_->next());
    if (!message) return false;
    const record::Topic& recorded = recording_->topics()[message->topic];
    for (std::size_t t = 0; t < graph_->topics.size(); ++t) {
      const Graph::Topic& topic = graph_->topics[t];
      if (topic.source < 0 || !record::is_app_topic(recorded, topic.spec.name)) continue;
      if (topic.spec.decode == nullptr)
        return fail(ErrorCode::kInvalid,
                    "messages of type " + topic.spec.type_name + " cannot be decoded",
                    "topic '" + topic.spec.name + "'", "specialise xauto::Codec for it");
      XAUTO_ASSIGN(const auto data, record::enclosed(recorded, message->data));
      if (messages[t] == nullptr) --left;
      messages[t] = topic.spec.decode(data);
    }
  }
  return true;
}

Status ProfileInput::wait_for_pushed(Messages& messages) {
  const std::int64_t limit = now_ns() + kPushNs;
  for (;;) {
    const std::uint32_t seen = inlets_->pushes();
    while (auto pushed = inlets_->take())
      messages[static_cast<std::size_t>(graph_->topic_of_source[pushed->source])] =
          std::move(pushed->waiting.message);
    const auto missing =
        std::find_if(graph_->topics.begin(), graph_->topics.end(), [&](const auto& topic) {
          const auto t = static_cast<std::size_t>(&topic - graph_->topics.data());
          return topic.source >= 0 && messages[t] == nullptr;
        });
    if (missing == graph_->topics.end()) return {};
    if (now_ns() >= limit)
      return fail(ErrorCode::kTimeout,
                  "nothing was published within " + std::to_string(kPushNs / 1'000'000'000) + " s",
                  "the source of topic '" + missing->spec.name + "'",
                  "it is pushed: have its driver run, from App::on_start on, or profile with "
                  "--input");
    inlets_->wait(seen, limit);
  }
}

}  // namespace xauto::runtime
