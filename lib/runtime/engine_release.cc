// SPDX-License-Identifier: Apache-2.0
// Before a job's first step: the sensors' releases, by their periods or from a recording; and
// waiting for what has been released.
#include <algorithm>
#include <set>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "record/recording.h"
#include "runtime/engine.h"
#include "runtime/notes.h"

namespace xauto::runtime {
namespace {

/// No progress for so long: give up, say what hangs.
constexpr std::int64_t kStallNs = 10'000'000'000;
/// Longer than any run, and a sum of two of them is no overflow.
constexpr std::int64_t kForeverNs = INT64_MAX / 4;

}  // namespace

/// How long to release, from the first release on. A count is of the slowest source's releases, so
/// that no source falls silent before the others.
std::int64_t Engine::run_length_ns(std::int64_t slowest_period_ns) const {
  if (session_.duration_us > 0) return session_.duration_us * 1000;
  const std::uint64_t count = session_.activations;
  if (count == 0 || count > static_cast<std::uint64_t>(kForeverNs / slowest_period_ns))
    return kForeverNs;
  return static_cast<std::int64_t>(count) * slowest_period_ns;
}

/// Every source at its period, on one absolute time grid, so that sources of equal period release
/// at the same instants and nothing drifts.
Status Engine::release_periodic() {
  struct Source {
    int topic;
    std::int64_t period_ns;
    std::uint64_t sequence = 0;
    /// Of its next release, from the first one of all on.
    [[nodiscard]] std::int64_t due_ns() const {
      return static_cast<std::int64_t>(sequence) * period_ns;
    }
  };
  std::vector<Source> sources;
  std::int64_t slowest_ns = 1;
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    if (graph_.topics[t].source < 0) continue;
    const auto& spec = app_.sources[static_cast<std::size_t>(graph_.topics[t].source)];
    const std::int64_t period_us =
        session_.period_us > 0 ? session_.period_us : spec.period.count();
    sources.push_back({static_cast<int>(t), period_us * 1000});
    slowest_ns = std::max(slowest_ns, period_us * 1000);
  }
  std::int64_t start = now_ns() + 20'000'000;
  const std::int64_t length_ns = run_length_ns(slowest_ns);
  while (!stop_.load()) {
    std::int64_t next_ns = length_ns;
    for (const Source& s : sources) next_ns = std::min(next_ns, s.due_ns());
    if (next_ns >= length_ns) break;
    std::int64_t due = start + next_ns;
    if (session_.lockstep) {
      if (!wait_drained())
        return fail(ErrorCode::kTimeout, "no progress for 10 s in lockstep",
                    "app '" + app_.name + "'");
      // Now, whatever the period: the time grid moves along.
      const std::int64_t now = now_ns();
      start += now - due;
      due = now;
    }
    // Messages are made before their release, so that making them does not count as latency.
    std::vector<Sample> samples, fed;
    std::int64_t fed_period_ns = 0;
    for (Source& s : sources) {
      if (s.due_ns() > next_ns) continue;
      if (interop_ && interop_->feeds(static_cast<std::size_t>(s.topic))) {
        fed_period_ns =
            s.sequence == 0 ? INT64_MAX : s.period_ns;  // nothing to do before the first
        fed.push_back({s.topic, s.sequence++, nullptr});
        continue;
      }
      const auto& spec = app_.sources[static_cast<std::size_t>(
          graph_.topics[static_cast<std::size_t>(s.topic)].source)];
      try {
        MessageMemory* memory = publishers_[static_cast<std::size_t>(s.topic)].get();
        samples.push_back({s.topic, s.sequence,
                           memory != nullptr && spec.make_in ? spec.make_in(s.sequence, memory)
                                                             : spec.make(s.sequence)});
      } catch (const std::exception& e) {
        return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(),
                    "the source of topic '" + spec.topic.name + "'");
      }
      ++s.sequence;
    }
    sleep_until_ns(due);
    if (!fed.empty()) {
      take_fed(std::move(fed), fed_period_ns, samples);
      if (stop_.load()) break;
      // The next release is a period after this one: the time grid follows whoever feeds us.
      if (graph_.single_rate) start += now_ns() - due;
      if (samples.empty()) continue;
    }
    release(now_ns(), samples);
  }
  return {};
}

/// Messages that programs outside feed us. In an app of one rate a release waits for its message,
/// for up to a period; without one it is lost, and told so downstream. Otherwise there is one or
/// there is none.
void Engine::take_fed(std::vector<Sample> fed, std::int64_t period_ns,
                      std::vector<Sample>& samples) {
  const std::int64_t now = now_ns();
  std::int64_t until = now;
  if (graph_.single_rate) until = period_ns > INT64_MAX - now ? INT64_MAX : now + period_ns;
  std::vector<int> topics;
  for (const Sample& sample : fed) topics.push_back(sample.topic);
  auto taken = interop_->take(topics, until, stop_);
  for (std::size_t i = 0; i < fed.size(); ++i) {
    if (taken[i] == nullptr && !graph_.single_rate) continue;
    fed[i].message = std::move(taken[i]);
    samples.push_back(std::move(fed[i]));
  }
}

void Engine::release(std::int64_t origin_ns, const std::vector<Sample>& samples) {
  const std::uint64_t sequence = samples.front().sequence;
  if (graph_.single_rate && num_sinks_ > 0) {
    const std::lock_guard lock(releases_mutex_);
    num_released_ = sequence + 1;
    while (open_base_ + open_.size() <= sequence) open_.push_back({});
    if (sequence >= open_base_)
      open_[sequence - open_base_] = {origin_ns, origin_ns, num_sinks_, false};
    if (in_flight_.fetch_add(1) > 0) ++overlapping_releases_;
  }
  board_->count_release();
  if (trace_) {
    // One release in an app of one rate, several otherwise.
    const std::size_t count = graph_.single_rate ? 1 : samples.size();
    for (std::size_t i = 0; i < count; ++i)
      trace_->write_at(origin_ns, XAUTO_EV_PUBLISH, samples[i].sequence, XAUTO_EV_NONE,
                       XAUTO_EV_NONE, XAUTO_EV_NONE);
  }
  if (recorder_) record(origin_ns, samples);
  for (const auto& [topic, number, message] : samples) {
    detail::Envelope envelope{message, origin_ns, number};
    if (!graph_.single_rate) {
      auto origins = std::make_shared<detail::Origins>();
      origins->fill(0);
      const auto source =
          static_cast<std::size_t>(graph_.topics[static_cast<std::size_t>(topic)].source);
      if (source < origins->size()) (*origins)[source] = origin_ns;
      envelope.origins = std::move(origins);
    }
    channels_[static_cast<std::size_t>(topic)].publish(envelope);
  }
}

Status Engine::open_recorder() {
  if (session_.record.empty()) return {};
  XAUTO_ASSIGN(auto recorder, record::Recorder::create(session_.record));
  recorder_.emplace(std::move(recorder));
  recorded_topic_.assign(graph_.topics.size(), 0);
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    const Graph::Topic& topic = graph_.topics[t];
    if (topic.source < 0) continue;
    if (topic.spec.encode == nullptr)
      return fail(ErrorCode::kInvalid,
                  "messages of type " + topic.spec.type_name + " cannot be recorded",
                  "topic '" + topic.spec.name + "'", "specialise xauto::Codec for it");
    XAUTO_ASSIGN(recorded_topic_[t],
                 recorder_->add_topic({topic.spec.name, topic.spec.type_name, "xauto"}));
  }
  return {};
}

/// The first failure ends the recording, not the run; the report tells.
void Engine::record(std::int64_t origin_ns, const std::vector<Sample>& samples) {
  for (const auto& [topic, sequence, message] : samples) {
    if (message == nullptr) continue;
    const auto t = static_cast<std::size_t>(topic);
    Status done;
    try {
      const std::vector<std::byte> bytes = graph_.topics[t].spec.encode(message.get());
      done = recorder_->write(recorded_topic_[t], origin_ns, bytes);
    } catch (const std::exception& e) {
      done = fail(ErrorCode::kIo, e.what(), session_.record);
    }
    if (done) continue;
    recording_error_ = "recording ended early: " + done.error().what;
    log::warn("{}", recording_error_);
    recorder_.reset();
    return;
  }
}

/// The topic of the source with the longest period.
int Engine::slowest_source() const {
  int slowest = -1;
  std::chrono::microseconds longest{0};
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    if (graph_.topics[t].source < 0) continue;
    const auto period = app_.sources[static_cast<std::size_t>(graph_.topics[t].source)].period;
    if (period > longest) {
      longest = period;
      slowest = static_cast<int>(t);
    }
  }
  return slowest;
}

/// Releases a recording's messages: message k of each recorded source topic is release k. In
/// lockstep, or at the recorded distances in time (or `period_us`).
Status Engine::release_recorded() {
  XAUTO_ASSIGN(auto recording, record::Recording::open(session_.input));
  std::vector<int> topic_of(recording.topics().size(), -1);
  std::set<int> missing;
  for (std::size_t t = 0; t < graph_.topics.size(); ++t)
    if (graph_.topics[t].source >= 0) missing.insert(static_cast<int>(t));
  for (std::size_t r = 0; r < recording.topics().size(); ++r)
    for (const int t : std::set<int>(missing))
      if (graph_.topics[static_cast<std::size_t>(t)].spec.name == recording.topics()[r].name) {
        topic_of[r] = t;
        missing.erase(t);
      }
  const auto topic_name = [&](int t) {
    return graph_.topics[static_cast<std::size_t>(t)].spec.name;
  };
  if (!missing.empty())
    return fail(ErrorCode::kInvalid,
                "has no messages for topic '" + topic_name(*missing.begin()) + "'", session_.input,
                "record the app's own sources with `xauto run --record`");

  std::vector<std::uint64_t> sequence(graph_.topics.size(), 0);
  // Messages of one instant are one release; so are the k-th messages of all topics in a
  // single-rate app.
  std::vector<Sample> batch;
  std::size_t num_topics = 0;
  for (const int t : topic_of) num_topics += t >= 0 ? 1 : 0;
  std::int64_t first_stamp = -1, start = 0;
  std::uint64_t releases = 0, counted = 0;  // of all sources; of the slowest
  const int slowest = slowest_source();
  while (!stop_.load() && (session_.activations == 0 || counted < session_.activations)) {
    XAUTO_ASSIGN(auto message, recording.next());
    if (!message) break;
    const int t = topic_of[message->topic];
    if (t < 0) continue;
    const detail::TopicSpec& spec = graph_.topics[static_cast<std::size_t>(t)].spec;
    if (spec.decode == nullptr)
      return fail(ErrorCode::kInvalid, "messages of type " + spec.type_name + " cannot be decoded",
                  "topic '" + spec.name + "'", "specialise xauto::Codec for it");
    std::uint64_t& number = sequence[static_cast<std::size_t>(t)];
    try {
      batch.push_back({t, number, spec.decode(message->data)});
    } catch (const std::exception& e) {
      return fail(ErrorCode::kInvalid, "message " + std::to_string(number) + ": " + e.what(),
                  session_.input + ": topic '" + spec.name + "'");
    }
    ++number;
    if (graph_.single_rate && batch.size() < num_topics) continue;
    if (first_stamp < 0) {
      first_stamp = message->timestamp_ns;
      start = now_ns() + 20'000'000;
    }
    const std::int64_t at_ns = session_.period_us > 0
                                   ? static_cast<std::int64_t>(releases) * session_.period_us * 1000
                                   : message->timestamp_ns - first_stamp;
    if (session_.duration_us > 0 && at_ns >= session_.duration_us * 1000) break;
    if (session_.lockstep) {
      if (!wait_drained())
        return fail(ErrorCode::kTimeout, "no progress for 10 s in lockstep",
                    "app '" + app_.name + "'");
    } else {
      sleep_until_ns(start + at_ns);
    }
    release(now_ns(), batch);
    batch.clear();
    ++releases;
    if (graph_.single_rate || t == slowest) ++counted;
  }
  return {};
}

/// Every module is through with every release. Those whose result nobody waits for, since another
/// input of the same release was lost, are so later than the sinks.
bool Engine::settled() const {
  for (std::size_t m = 0; m < graph_.modules.size(); ++m)
    if (board_->module(static_cast<int>(m)).settled() < num_released_) return false;
  return true;
}

/// Single rate: until every release is accounted for. Otherwise there is nothing to count by, so:
/// until no module has an activation in flight or has ended one for 100 ms. False after kStallNs
/// without progress.
bool Engine::wait_drained() {
  if (!graph_.single_rate) {
    std::int64_t since = now_ns();
    for (std::uint64_t before = board_->settled();;) {
      sleep_until_ns(now_ns() + 100'000'000);
      const std::uint64_t settled = board_->settled();
      if (settled == before && !board_->busy()) return true;
      if (settled != before) since = now_ns();
      if (now_ns() - since > kStallNs) return false;
      before = settled;
    }
  }
  std::int64_t since = now_ns();
  std::uint64_t settled_before = 0;
  for (std::uint32_t last = in_flight_.load();;) {
    const std::uint32_t left = in_flight_.load();
    if (left == 0 && !settled()) {
      if (const std::uint64_t sum = board_->settled(); sum != settled_before) {
        settled_before = sum;
        since = now_ns();
      }
      if (now_ns() - since > kStallNs) return false;
      sleep_until_ns(now_ns() + 20'000);
      continue;
    }
    if (left == 0) {
      // A sink's process says that it is through beside its messages, which observers here get.
      while (receiver_ && !receiver_->idle()) sleep_until_ns(now_ns() + 20'000);
      return true;
    }
    if (left != last) since = now_ns();
    last = left;
    if (now_ns() - since > kStallNs) return false;
    futex_wait_local(in_flight_, left, 50'000'000);
  }
}

}  // namespace xauto::runtime
