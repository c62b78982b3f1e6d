// SPDX-License-Identifier: Apache-2.0
// One topic that goes to DDS: a ring in which messages wait for the thread "xauto/dds".
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <dds/dds.h>

#include "base/pi_mutex.h"
#include "transport/cyclonedds/wire.h"
#include "transport/cyclonedds/work.h"
#include "transport/transport.h"

namespace xauto::transport {

class DdsPublisher final : public Publisher {
 public:
  /// `type` is the topic's, and lives as long as it.
  DdsPublisher(Wire wire, const ddsi_sertype* type, dds_entity_t writer, std::size_t depth,
               std::shared_ptr<Work> work)
      : wire_(std::move(wire)),
        type_(type),
        writer_(writer),
        work_(std::move(work)),
        ring_(depth) {}

  std::shared_ptr<void> loan(std::size_t) override { return nullptr; }
  void publish(const detail::Envelope& envelope) override {
    next_sequence_.store(envelope.sequence + 1, std::memory_order_relaxed);
    if (envelope.message == nullptr) return;  // of the app's own accounts
    {
      const Guard lock(mutex_);
      if (count_ == ring_.size()) {
        ring_[first_] = {};
        first_ = (first_ + 1) % ring_.size();
        --count_;
        dropped_.fetch_add(1, std::memory_order_relaxed);
      }
      ring_[(first_ + count_++) % ring_.size()] = envelope;
    }
    work_->doorbell.ring();
  }
  [[nodiscard]] Sender sender() override {
    return [this](const detail::Envelope& envelope) { publish(envelope); };
  }
  [[nodiscard]] std::uint64_t next_sequence() const override { return next_sequence_.load(); }
  [[nodiscard]] std::uint64_t unsent() const override { return dropped_.load() + refused_.load(); }

  [[nodiscard]] std::size_t readers() const override {
    dds_publication_matched_status_t matched{};
    const bool told = dds_get_publication_matched_status(writer_, &matched) == DDS_RETCODE_OK;
    return told ? matched.current_count : 0;
  }

  // Of the bridge's thread.
  [[nodiscard]] bool empty() const {
    const Guard lock(mutex_);
    return count_ == 0;
  }
  /// Writes one message; false: none waits.
  bool write_one() {
    detail::Envelope envelope;
    {
      const Guard lock(mutex_);
      if (count_ == 0) return false;
      envelope = std::exchange(ring_[first_], {});
      first_ = (first_ + 1) % ring_.size();
      --count_;
    }
    if (!write(envelope)) refused_.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  void note(std::vector<std::string>& notes) const {
    if (const auto n = dropped_.load(); n > 0)
      notes.push_back("topic '" + wire_.spec().name + "' to DDS: " + std::to_string(n) +
                      " messages were lost, they came faster than DDS takes them");
    if (const auto n = refused_.load(); n > 0)
      notes.push_back("topic '" + wire_.spec().name + "' to DDS: " + std::to_string(n) +
                      " messages could not be sent: encoded they are too large, or DDS refused");
    dds_offered_deadline_missed_status_t deadline{};
    if (dds_get_offered_deadline_missed_status(writer_, &deadline) == DDS_RETCODE_OK &&
        deadline.total_count > 0)
      notes.push_back("topic '" + wire_.spec().name + "' to DDS: its deadline was missed " +
                      std::to_string(deadline.total_count) + " times");
  }
  void finish(std::int64_t limit_ns) { (void)dds_wait_for_acks(writer_, limit_ns); }

 private:
  bool write(const detail::Envelope& envelope) {
    SamplePtr sample = wire_.encode(*type_, envelope);
    return sample != nullptr && dds_writecdr(writer_, sample.release()) == DDS_RETCODE_OK;
  }

  const Wire wire_;
  const ddsi_sertype* const type_;
  const dds_entity_t writer_;
  const std::shared_ptr<Work> work_;
  mutable PiMutex mutex_;
  std::vector<detail::Envelope> ring_ XAUTO_GUARDED_BY(mutex_);
  std::size_t first_ XAUTO_GUARDED_BY(mutex_) = 0, count_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::atomic<std::uint64_t> next_sequence_{0}, dropped_{0}, refused_{0};
};

}  // namespace xauto::transport
