// SPDX-License-Identifier: Apache-2.0
#include "releases/run_recorder.h"

#include <algorithm>
#include <utility>

#include "base/clock.h"
#include "base/log.h"
#include "record/xauto_msgs.h"

namespace xauto::runtime {

Result<std::unique_ptr<RunRecorder>> RunRecorder::open(const Context& context, Wiring& wiring) {
  if (context.session.releases.record.empty()) return std::unique_ptr<RunRecorder>();
  std::unique_ptr<RunRecorder> run(new RunRecorder(context));
  XAUTO_ASSIGN(auto recorder, record::Recorder::create(context.session.releases.record));
  run->recorded_topic_.assign(context.graph.topics.size(), 0);
  for (std::size_t t = 0; t < context.graph.topics.size(); ++t)
    XAUTO_TRY(run->record_topic(recorder, wiring, t));
  if (context.graph.single_rate) {
    XAUTO_ASSIGN(run->releases_topic_, recorder.add_topic(record::releases_topic()));
  }
  XAUTO_ASSIGN(run->recorder_, record::BackgroundRecorder::start(std::move(recorder)));
  // Once: so the distances between messages are those that were measured, whoever sets the clock.
  run->wall_offset_ns_ = clock_ns(CLOCK_REALTIME) - now_ns();
  run->records_.store(true);
  return run;
}

/// What modules publish is recorded when it arrives here, on the thread that brings it.
Status RunRecorder::record_topic(record::Recorder& recorder, Wiring& wiring, std::size_t topic) {
  const Graph::Topic& of = context_.graph.topics[topic];
  const bool is_source = of.source >= 0;
  if (!is_source && !context_.session.releases.record_outputs) return {};
  if (of.spec.encode == nullptr) {
    if (is_source)
      return fail(ErrorCode::kInvalid,
                  "messages of type " + of.spec.type_name + " cannot be recorded",
                  "topic '" + of.spec.name + "'", "specialise xauto::Codec for it");
    notes_.push_back("topic '" + of.spec.name + "' is not recorded: " + of.spec.type_name +
                     " has no xauto::Codec");
    return {};
  }
  XAUTO_ASSIGN(recorded_topic_[topic], recorder.add_topic(record::app_topic(
                                           of.spec.name, of.spec.ros_type, of.spec.schema)));
  if (!is_source)
    wiring.channel(topic).subscribe([this, topic](const detail::Envelope& envelope) {
      record(topic, now_ns(), envelope.sequence, envelope.message.get());
    });
  return {};
}

void RunRecorder::record(std::size_t topic, std::int64_t now_ns, std::uint64_t sequence,
                         const void* message) {
  if (message == nullptr || !records_.load(std::memory_order_relaxed)) return;
  const auto if_full = context_.session.releases.lockstep
                           ? record::BackgroundRecorder::IfFull::kWait
                           : record::BackgroundRecorder::IfFull::kLose;
  const std::int64_t stamp_ns = now_ns + wall_offset_ns_;
  try {
    const detail::TopicSpec& spec = context_.graph.topics[topic].spec;
    std::vector<std::byte> bytes = spec.encode(message);
    if (spec.ros_type.empty())
      recorder_->write_enclosed(recorded_topic_[topic], stamp_ns, sequence, std::move(bytes),
                                if_full);
    else
      recorder_->write(recorded_topic_[topic], stamp_ns, std::move(bytes), if_full);
  } catch (const std::exception& e) {
    if (!records_.exchange(false)) return;
    const Guard lock(mutex_);
    error_ = std::string("recording ended early: ") + e.what();
    log::warn("{}", error_);
  }
}

std::string RunRecorder::close(const std::vector<ReleaseRecord>& releases) {
  records_.store(false);
  // At the end, where nobody waits for it.
  for (const ReleaseRecord& release : releases) {
    const std::int64_t stamp_ns = release.origin_ns + wall_offset_ns_;
    const std::int64_t end_ns = stamp_ns + std::max<std::int64_t>(release.latency_us, 0) * 1000;
    recorder_->write(releases_topic_, end_ns,
                     record::encode_release(stamp_ns, release.sequence, release.latency_us));
  }
  const Status closed = recorder_->close();
  const Guard lock(mutex_);
  if (!closed && error_.empty()) error_ = closed.error().what;
  return error_;
}

}  // namespace xauto::runtime
