// SPDX-License-Identifier: Apache-2.0
// One topic that is fed from DDS.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <dds/dds.h>

#include "transport/cyclonedds/sample.h"
#include "transport/cyclonedds/wire.h"
#include "transport/cyclonedds/work.h"
#include "transport/doorbell.h"
#include "transport/transport.h"

namespace xauto::transport {

/// What is older counts from its arrival: it is no sensor's time but a replay's, or of another clock.
inline constexpr std::int64_t kOldestStampNs = 10'000'000'000;

/// A reader hears only publishers that offer what it asks for. One that asks for reliable delivery
/// misses those that offer best effort; one that asks for best effort hears all, but nothing is sent
/// again to it. Where the deployment does not choose, the first publisher that offers no more than best
/// effort makes a second reader necessary: what the first one hears, the second leaves out. (With both
/// from the beginning a message of 6 MB from a reliable publisher took 4 % longer.)
class DdsSubscriber final : public Subscriber {
 public:
  /// `ask`: rung where it wants a second reader.
  DdsSubscriber(Wire wire, Doorbell& arrived, std::shared_ptr<Work> ask, Replaced replaced)
      : wire_(std::move(wire)),
        arrived_(arrived),
        ask_(std::move(ask)),
        replaced_(std::move(replaced)) {}

  // Called on threads of Cyclone DDS.
  static void on_data(dds_entity_t, void* self);
  static void on_misfit(dds_entity_t, dds_requested_incompatible_qos_status_t status, void* self);
  /// Cyclone has waited for the last call; this says so to whoever checks our own order.
  ~DdsSubscriber() override { (void)calls_.load(std::memory_order_acquire); }
  /// The most demanding one first; two at most.
  void read_from(dds_entity_t reader) {
    readers_[num_readers_.load()] = reader;
    num_readers_.fetch_add(1);
    fresh_.store(true);  // it may have had a message before
    arrived_.ring();
  }
  /// Once, on the bridge's thread: a publisher was found that only a reader of best effort hears.
  [[nodiscard]] bool takes_wish() { return wish_.load() && wish_.exchange(false); }
  [[nodiscard]] bool wishes() const { return wish_.load(); }

  std::optional<detail::Envelope> take() override { return next(true); }
  std::optional<detail::Envelope> take_blank() override { return next(false); }
  [[nodiscard]] bool empty() const override { return !fresh_.load(); }
  [[nodiscard]] std::uint64_t lost() const override { return refused_.load(); }
  [[nodiscard]] std::uint64_t replaced() const override { return replaced_->load(); }

  [[nodiscard]] std::size_t publishers() const override {
    std::size_t all = 0;
    for (std::size_t r = 0; r < num_readers_.load(); ++r) {
      dds_subscription_matched_status_t matched{};
      if (dds_get_subscription_matched_status(readers_[r], &matched) == DDS_RETCODE_OK)
        all += matched.current_count;
    }
    return all;
  }

  void note(std::vector<std::string>& notes) const;
  [[nodiscard]] const std::string& topic() const { return wire_.spec().name; }

 private:
  std::optional<detail::Envelope> next(bool with_message);
  /// False: there is none. The sample is null where it is no message, or one that was heard already.
  bool take_from(std::size_t reader, SamplePtr& sample);
  [[nodiscard]] bool heard_by_first(const dds_sample_info_t& info);
  [[nodiscard]] std::int64_t origin_of(const Wire::Received& received);

  const Wire wire_;
  Doorbell& arrived_;
  const std::shared_ptr<Work> ask_;
  const Replaced replaced_;
  std::array<dds_entity_t, 2> readers_{};  ///< written before num_readers_ counts them
  std::atomic<std::size_t> num_readers_{0};
  std::atomic<bool> wish_{false}, wished_{false};
  std::vector<dds_instance_handle_t> matched_;  ///< room
  dds_instance_handle_t last_publisher_ = 0;    ///< of what the first reader has heard
  dds_time_t last_sent_ = 0;                    ///< ... and when it was sent
  std::atomic<bool> fresh_{false};
  std::atomic<std::uint64_t> calls_{0};
  std::atomic<std::uint64_t> taken_{0}, refused_{0}, unstamped_{0};
};

}  // namespace xauto::transport
