// SPDX-License-Identifier: Apache-2.0
#include "graph/inlet.h"

#include <algorithm>
#include <climits>

#include "base/clock.h"
#include "base/futex.h"
#include "graph/app_spec.h"

namespace xauto::detail {
namespace {

std::string in_us(std::int64_t ns) {
  return std::to_string(ns / 1000) + " us";
}

}  // namespace

Status push(Inlet& inlet, std::shared_ptr<const void> message) {
  return inlet.push(std::move(message));
}

Status push_urgent(Inlet& inlet, std::shared_ptr<const void> message) {
  return inlet.push(std::move(message), true);
}

Status Inlet::push(std::shared_ptr<const void> message, bool urgent) {
  const std::string where = "topic '" + topic_ + "'";
  if (message == nullptr) return fail(ErrorCode::kInvalid, "a null message was published", where);
  const Guard lock(mutex_);
  if (bell_ == nullptr)
    return fail(ErrorCode::kUnavailable,
                "a message was published while the app takes none: it does not run yet or any "
                "more, or its sources are in another process",
                where, "publish between the calls of App::on_start and App::on_stop");
  if (keep_ == Keep::kNone) return {};
  if (urgent && urgent_ == Urgent::kRefused)
    return fail(ErrorCode::kInvalid,
                "an urgent message was published, and nothing certifies that in this run", where,
                "state \"urgent\": {\"by_us\", \"every_us\"} of this source in app.json, "
                "solve again, and run by that policy");
  if (keep_ == Keep::kNewest) waiting_.clear();
  if (waiting_.size() >= kMaxWaiting)
    return fail(ErrorCode::kUnavailable,
                std::to_string(kMaxWaiting) + " messages wait to be released", where,
                "publish slower in lockstep: it releases the next when the last has drained");
  const std::int64_t now = now_ns();
  if (const std::int64_t distance = now - last_ns_; last_ns_ != 0 && distance < distance_ns_) {
    early_.shortest_ns = early_.count == 0 ? distance : std::min(early_.shortest_ns, distance);
    ++early_.count;
  }
  ++early_.of;
  last_ns_ = now;
  waiting_.push_back({std::move(message), now, urgent && urgent_ == Urgent::kTaken});
  bell_->fetch_add(1);
  futex_wake_local(*bell_, INT_MAX);
  return {};
}

void Inlet::open(std::atomic<std::uint32_t>& bell, Keep keep) {
  const Guard lock(mutex_);
  bell_ = &bell;
  keep_ = keep;
  urgent_ = Urgent::kOrdinary;
  last_ns_ = 0;
  early_ = {};
}

void Inlet::take_urgent(Urgent how) {
  const Guard lock(mutex_);
  urgent_ = how;
}

std::size_t Inlet::close() {
  const Guard lock(mutex_);
  bell_ = nullptr;
  const std::size_t left = waiting_.size();
  waiting_.clear();
  return left;
}

std::optional<Inlet::Waiting> Inlet::take() {
  const Guard lock(mutex_);
  if (waiting_.empty()) return std::nullopt;
  Waiting first = std::move(waiting_.front());
  waiting_.pop_front();
  return first;
}

std::int64_t Inlet::oldest_ns() const {
  const Guard lock(mutex_);
  return waiting_.empty() ? INT64_MAX : waiting_.front().at_ns;
}

Inlet::Early Inlet::early() const {
  const Guard lock(mutex_);
  return early_;
}

Inlets::Inlets(const AppSpecErased& app, Inlet::Keep keep) {
  for (std::size_t s = 0; s < app.sources.size(); ++s)
    if (const SourceSpec& source = app.sources[s]; source.inlet != nullptr) {
      inlets_.push_back(
          {s, source.inlet.get(), source.topic.name, source.period.floor_us() * 1000});
      source.inlet->open(bell_, keep);
    }
}

Inlet& Inlets::add(std::size_t source, const std::string& topic) {
  thread_.check();
  added_.push_back(std::make_unique<Inlet>(topic, 0));
  added_.back()->open(bell_, Inlet::Keep::kAll);
  inlets_.push_back({source, added_.back().get(), topic, 0});
  return *added_.back();
}

Inlets::~Inlets() {
  for (const Entry& entry : inlets_) entry.inlet->close();
}

std::optional<Inlets::Pushed> Inlets::take() {
  thread_.check();
  const Entry* oldest = nullptr;
  std::int64_t at_ns = INT64_MAX;
  for (const Entry& entry : inlets_)
    if (const std::int64_t ns = entry.inlet->oldest_ns(); ns < at_ns) {
      at_ns = ns;
      oldest = &entry;
    }
  if (oldest == nullptr) return std::nullopt;
  auto waiting = oldest->inlet->take();
  if (!waiting) return std::nullopt;
  return Pushed{oldest->source, std::move(*waiting)};
}

void Inlets::wait(std::uint32_t seen, std::int64_t until_ns) {
  thread_.check();
  if (const std::int64_t left = until_ns - now_ns(); left > 0)
    futex_wait_local(bell_, seen, std::min(left, kLookNs));
}

std::vector<std::string> Inlets::close() {
  thread_.check();
  std::vector<std::string> notes;
  for (const Entry& entry : inlets_) {
    const std::size_t left = entry.inlet->close();
    const Inlet::Early early = entry.inlet->early();
    const std::string source = "source '" + entry.topic + "': ";
    if (early.count > 0)
      notes.push_back(source + std::to_string(early.count) + " of " + std::to_string(early.of) +
                      " messages came less than the declared " + in_us(entry.distance_ns) +
                      " after the one before, the closest after " + in_us(early.shortest_ns));
    if (left > 0)
      notes.push_back(source + std::to_string(left) +
                      " messages were not released: the run was at its end");
  }
  return notes;
}

}  // namespace xauto::detail
