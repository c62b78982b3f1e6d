// SPDX-License-Identifier: Apache-2.0
// One topic that is fed from DDS.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <dds/dds.h>

#include "transport/cyclonedds/wire.h"
#include "transport/doorbell.h"
#include "transport/transport.h"

namespace xauto::transport {

/// What is older counts from its arrival: it is no sensor's time but a replay's, or of another clock.
inline constexpr std::int64_t kOldestStampNs = 10'000'000'000;

/// A reader hears only publishers that offer what it asks for. One that asks for reliable delivery
/// misses those that offer best effort; one that asks for best effort hears all, but nothing is sent
/// again to it. Where the deployment does not choose, there is one of each: what the first hears,
/// the second leaves out.
class DdsSubscriber final : public Subscriber {
 public:
  DdsSubscriber(Wire wire, Doorbell& arrived) : wire_(std::move(wire)), arrived_(arrived) {}

  /// Called on a thread of Cyclone DDS.
  static void on_data(dds_entity_t, void* self);
  /// Cyclone has waited for the last call; this says so to whoever checks our own order.
  ~DdsSubscriber() override { (void)calls_.load(std::memory_order_acquire); }
  /// The most demanding one first; two at most.
  void read_from(std::vector<dds_entity_t> readers) { readers_ = std::move(readers); }

  std::optional<detail::Envelope> take() override { return next(true); }
  std::optional<detail::Envelope> take_blank() override { return next(false); }
  [[nodiscard]] bool empty() const override { return !fresh_.load(); }
  [[nodiscard]] std::uint64_t lost() const override { return refused_.load(); }

  void note(std::vector<std::string>& notes) const;

 private:
  std::optional<detail::Envelope> next(bool with_message);
  /// False: there is none. The sample is null where it is no message, or one that was heard already.
  bool take_from(std::size_t reader, SamplePtr& sample);
  [[nodiscard]] bool heard_by_first(const dds_sample_info_t& info);
  [[nodiscard]] std::int64_t origin_of(const Wire::Received& received);

  const Wire wire_;
  Doorbell& arrived_;
  std::vector<dds_entity_t> readers_;
  std::vector<dds_instance_handle_t> matched_;  ///< room
  dds_instance_handle_t last_publisher_ = 0;    ///< of what the first reader has heard
  dds_time_t last_sent_ = 0;                    ///< ... and when it was sent
  std::atomic<bool> fresh_{false};
  std::atomic<std::uint64_t> calls_{0};
  std::atomic<std::uint64_t> taken_{0}, refused_{0}, unstamped_{0};
};

}  // namespace xauto::transport
