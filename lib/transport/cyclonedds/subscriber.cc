// SPDX-License-Identifier: Apache-2.0
#include "transport/cyclonedds/subscriber.h"

#include <algorithm>
#include <ctime>

#include "base/clock.h"

namespace xauto::transport {
namespace {

constexpr std::uint32_t kAnyState =
    DDS_ANY_SAMPLE_STATE | DDS_ANY_VIEW_STATE | DDS_ANY_INSTANCE_STATE;

/// What a publisher's QoS lacks, in the words of deployment.json.
std::string policy_name(std::uint32_t policy) {
  switch (policy) {
    case DDS_RELIABILITY_QOS_POLICY_ID:
      return "reliability";
    case DDS_DURABILITY_QOS_POLICY_ID:
      return "durability";
    case DDS_DEADLINE_QOS_POLICY_ID:
      return "deadline";
    default:
      return "policy " + std::to_string(policy) + " of DDS";
  }
}

}  // namespace

void DdsSubscriber::on_data(dds_entity_t, void* self) {
  auto& subscriber = *static_cast<DdsSubscriber*>(self);
  subscriber.fresh_.store(true);
  subscriber.arrived_.ring();
  subscriber.calls_.fetch_add(1, std::memory_order_release);
}

void DdsSubscriber::on_misfit(dds_entity_t, dds_requested_incompatible_qos_status_t status,
                              void* self) {
  auto& subscriber = *static_cast<DdsSubscriber*>(self);
  if (status.last_policy_id == DDS_RELIABILITY_QOS_POLICY_ID &&
      !subscriber.wished_.exchange(true)) {
    subscriber.wish_.store(true);
    subscriber.ask_->doorbell.ring();
  }
  subscriber.calls_.fetch_add(1, std::memory_order_release);
}

std::optional<detail::Envelope> DdsSubscriber::next(bool with_message) {
  for (;;) {
    fresh_.store(false);
    bool any = false;
    for (std::size_t r = 0; r < num_readers_.load(); ++r) {
      SamplePtr sample;
      if (!take_from(r, sample)) continue;
      any = true;
      if (sample == nullptr) continue;
      taken_.fetch_add(1, std::memory_order_relaxed);
      const Sample& received = *sample;
      if (auto message = wire_.decode(received.bytes(), with_message)) {
        const std::int64_t origin_ns = with_message ? origin_of(*message) : now_ns();
        return detail::Envelope{std::move(message->message), origin_ns, message->sequence};
      }
      refused_.fetch_add(1, std::memory_order_relaxed);
    }
    if (!any) return std::nullopt;
  }
}

bool DdsSubscriber::take_from(std::size_t reader, SamplePtr& sample) {
  ddsi_serdata* data = nullptr;
  dds_sample_info_t info;
  if (dds_takecdr(readers_[reader], &data, 1, &info, kAnyState) != 1) return false;
  SamplePtr taken(static_cast<Sample*>(data));
  if (!info.valid_data) return true;  // a publisher went
  taken->taken.store(true);
  if (reader == 0) {
    last_publisher_ = info.publication_handle;
    last_sent_ = info.source_timestamp;
  } else if (heard_by_first(info)) {
    return true;
  }
  sample = std::move(taken);
  return true;
}

/// Its publisher offers reliable delivery; or has, and is gone.
bool DdsSubscriber::heard_by_first(const dds_sample_info_t& info) {
  if (info.publication_handle == last_publisher_ && info.source_timestamp <= last_sent_)
    return true;
  for (;;) {
    const dds_return_t count =
        dds_get_matched_publications(readers_.front(), matched_.data(), matched_.size());
    if (count < 0) return false;
    const auto all = static_cast<std::size_t>(count);
    if (all <= matched_.size())
      return std::find(matched_.begin(), matched_.begin() + count, info.publication_handle) !=
             matched_.begin() + count;
    matched_.resize(all + 8);
  }
}

std::int64_t DdsSubscriber::origin_of(const Wire::Received& received) {
  const std::int64_t arrival_ns = now_ns();
  if (!received.stamped) return arrival_ns;
  timespec wall{};
  clock_gettime(CLOCK_REALTIME, &wall);
  const std::int64_t age_ns =
      static_cast<std::int64_t>(wall.tv_sec) * 1'000'000'000 + wall.tv_nsec - received.stamp_ns;
  if (age_ns >= 0 && age_ns <= kOldestStampNs) return arrival_ns - age_ns;
  unstamped_.fetch_add(1, std::memory_order_relaxed);
  return arrival_ns;
}

void DdsSubscriber::note(std::vector<std::string>& notes) const {
  const std::string topic = "topic '" + wire_.spec().name + "' from DDS: ";
  if (const auto n = refused_.load(); n > 0)
    notes.push_back(
        topic + std::to_string(n) + " messages were refused, they are no " +
        (wire_.spec().ros_type.empty() ? wire_.spec().type_name : wire_.spec().ros_type));
  if (const auto n = unstamped_.load(); n > 0)
    notes.push_back(topic + std::to_string(n) + " of " + std::to_string(taken_.load()) +
                    " messages count from their arrival: their stamp is not set, in the future, "
                    "or more than 10 s old");
  if (num_readers_.load() == 0) return;
  const dds_entity_t reader =
      readers_[num_readers_.load() - 1];  // what it does not hear nobody does
  dds_requested_incompatible_qos_status_t qos{};
  if (dds_get_requested_incompatible_qos_status(reader, &qos) == DDS_RETCODE_OK &&
      qos.total_count > 0)
    notes.push_back(topic +
                    "a publisher was not heard, since it offers less than the deployment's " +
                    policy_name(qos.last_policy_id));
  dds_requested_deadline_missed_status_t deadline{};
  if (dds_get_requested_deadline_missed_status(reader, &deadline) == DDS_RETCODE_OK &&
      deadline.total_count > 0)
    notes.push_back(topic + "its deadline was missed " + std::to_string(deadline.total_count) +
                    " times");
}

}  // namespace xauto::transport
