// SPDX-License-Identifier: Apache-2.0
// Topics to and from DDS, in the way of ROS 2: topic NAME is "rt/NAME", of the type that the ROS 2
// package xauto_msgs would have (docs/interop.md has its Message.msg). A message's bytes are those
// of xauto::Codec, which for plain data are its memory.
//
//   publisher: publish() ─► a ring of kBridgeQueue per topic ─► thread "xauto/dds" ─► dds_write
//   reader:    a thread of Cyclone DDS ─► the newest message waits, the doorbell is rung ─► take()
//
// Nothing from outside can hold up the app, or make it store more than one message per topic, none
// of which is larger than the topic's largest.
#include <algorithm>
#include <array>
#include <atomic>
#include <cctype>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <thread>

#include <dds/dds.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/pi_mutex.h"
#include "base/rt.h"
#include "transport/bridge.h"

namespace xauto::transport {
namespace {

/// builtin_interfaces/Time stamp, uint64 number, uint8[] data. A nested struct that is final and
/// has no keys lies in its parent, in memory and on the wire, so the stamp needs no type of its
/// own.
struct Message {
  std::int32_t stamp_sec;
  std::uint32_t stamp_nanosec;
  std::uint64_t number;
  struct {
    std::uint32_t maximum, length;
    std::uint8_t* buffer;
    bool release;
  } data;
};

constexpr std::uint32_t op(std::uint32_t type) {
  return static_cast<std::uint32_t>(DDS_OP_ADR) | type;
}
const std::uint32_t kMessageOps[] = {
    op(DDS_OP_TYPE_4BY) | DDS_OP_FLAG_SGN,
    offsetof(Message, stamp_sec),
    op(DDS_OP_TYPE_4BY),
    offsetof(Message, stamp_nanosec),
    op(DDS_OP_TYPE_8BY),
    offsetof(Message, number),
    op(DDS_OP_TYPE_SEQ) | static_cast<std::uint32_t>(DDS_OP_SUBTYPE_1BY),
    offsetof(Message, data),
    DDS_OP_RTS};

const dds_topic_descriptor_t kMessageType = {sizeof(Message),
                                             alignof(Message),
                                             0,
                                             0,
                                             "xauto_msgs::msg::dds_::Message_",
                                             nullptr,
                                             5,
                                             kMessageOps,
                                             "",
                                             {nullptr, 0},
                                             {nullptr, 0},
                                             0};

constexpr std::int64_t kBlockingNs = 10'000'000;  ///< dds_write, when a reader does not keep up
constexpr std::int64_t kDrainNs = 1'000'000'000;  ///< of the last messages
constexpr std::size_t kLeastBytes = 64 * 1024;    ///< what DDS says of itself must fit, too
constexpr int kMaxDomain = 232;

std::string reason(dds_return_t code) {
  return dds_strretcode(code);
}

/// ROS 2's rules: letters, digits, '_' and '/', no digit first.
bool ros_name(const std::string& name) {
  bool first = true;
  for (const char c : name) {
    const bool letter = std::isalpha(static_cast<unsigned char>(c)) != 0 || c == '_';
    if (!letter && (first || (c != '/' && std::isdigit(static_cast<unsigned char>(c)) == 0)))
      return false;
    first = c == '/';
  }
  return !name.empty() && !first && name.size() <= 200;
}

struct Qos {
  explicit Qos(std::int32_t depth) : qos(dds_create_qos()) {
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, kBlockingNs);
    dds_qset_durability(qos, DDS_DURABILITY_VOLATILE);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, depth);
  }
  ~Qos() { dds_delete_qos(qos); }
  Qos(const Qos&) = delete;
  Qos& operator=(const Qos&) = delete;
  dds_qos_t* qos;
};

/// The writing thread's alarm clock: rung by publishers, which may be real-time threads.
struct Work {
  std::atomic<bool> quit{false};
  Doorbell doorbell;
};

class DdsPublisher final : public Publisher {
 public:
  DdsPublisher(detail::TopicSpec spec, dds_entity_t writer, std::shared_ptr<Work> work)
      : spec_(std::move(spec)), writer_(writer), work_(std::move(work)) {}

  std::shared_ptr<void> loan(std::size_t) override { return nullptr; }
  void publish(const detail::Envelope& envelope) override {
    next_sequence_.store(envelope.sequence + 1, std::memory_order_relaxed);
    if (envelope.message == nullptr) return;  // of the app's own accounts
    {
      const Guard lock(mutex_);
      if (count_ == kBridgeQueue) {
        ring_[first_] = {};
        first_ = (first_ + 1) % kBridgeQueue;
        --count_;
        dropped_.fetch_add(1, std::memory_order_relaxed);
      }
      ring_[(first_ + count_++) % kBridgeQueue] = envelope;
    }
    work_->doorbell.ring();
  }
  [[nodiscard]] Sender sender() override {
    return [this](const detail::Envelope& envelope) { publish(envelope); };
  }
  [[nodiscard]] std::uint64_t next_sequence() const override { return next_sequence_.load(); }
  [[nodiscard]] std::uint64_t unsent() const override { return dropped_.load() + refused_.load(); }

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
      first_ = (first_ + 1) % kBridgeQueue;
      --count_;
    }
    if (!write(envelope)) refused_.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  void note(std::vector<std::string>& notes) const {
    if (const auto n = dropped_.load(); n > 0)
      notes.push_back("topic '" + spec_.name + "' to DDS: " + std::to_string(n) +
                      " messages were lost, they came faster than DDS takes them");
    if (const auto n = refused_.load(); n > 0)
      notes.push_back("topic '" + spec_.name + "' to DDS: " + std::to_string(n) +
                      " messages could not be sent");
  }
  void finish(std::int64_t limit_ns) { (void)dds_wait_for_acks(writer_, limit_ns); }

 private:
  bool write(const detail::Envelope& envelope) {
    std::vector<std::byte> encoded;
    const void* bytes = envelope.message.get();
    std::size_t size = spec_.plain_bytes;
    if (size == 0) {
      try {
        encoded = spec_.encode(envelope.message.get());
      } catch (...) {
        return false;
      }
      bytes = encoded.data();
      size = encoded.size();
      if (size > spec_.max_bytes) return false;
    }
    timespec wall{};
    clock_gettime(CLOCK_REALTIME, &wall);
    const std::int64_t stamp = static_cast<std::int64_t>(wall.tv_sec) * 1'000'000'000 +
                               wall.tv_nsec - (now_ns() - envelope.origin_ns);
    Message message{};
    message.stamp_sec = static_cast<std::int32_t>(stamp / 1'000'000'000);
    message.stamp_nanosec = static_cast<std::uint32_t>(stamp % 1'000'000'000);
    message.number = envelope.sequence;
    message.data.buffer = static_cast<std::uint8_t*>(const_cast<void*>(bytes));
    message.data.length = message.data.maximum = static_cast<std::uint32_t>(size);
    return dds_write(writer_, &message) == DDS_RETCODE_OK;
  }

  const detail::TopicSpec spec_;
  const dds_entity_t writer_;
  const std::shared_ptr<Work> work_;
  mutable PiMutex mutex_;
  std::array<detail::Envelope, kBridgeQueue> ring_ XAUTO_GUARDED_BY(mutex_);
  std::size_t first_ XAUTO_GUARDED_BY(mutex_) = 0, count_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::atomic<std::uint64_t> next_sequence_{0}, dropped_{0}, refused_{0};
};

class DdsSubscriber final : public Subscriber {
 public:
  DdsSubscriber(detail::TopicSpec spec, Doorbell& arrived)
      : spec_(std::move(spec)), arrived_(arrived) {}

  /// Called on a thread of Cyclone DDS.
  static void on_data(dds_entity_t, void* self) {
    auto& subscriber = *static_cast<DdsSubscriber*>(self);
    subscriber.fresh_.store(true);
    subscriber.arrived_.ring();
    subscriber.calls_.fetch_add(1, std::memory_order_release);
  }
  /// Cyclone has waited for the last call; this says so to whoever checks our own order.
  ~DdsSubscriber() override { (void)calls_.load(std::memory_order_acquire); }
  void read_from(dds_entity_t reader) { reader_ = reader; }

  std::optional<detail::Envelope> take() override { return next(true); }
  std::optional<detail::Envelope> take_blank() override { return next(false); }
  [[nodiscard]] bool empty() const override { return !fresh_.load(); }
  [[nodiscard]] std::uint64_t lost() const override { return refused_.load(); }

  void note(std::vector<std::string>& notes) const {
    if (const auto n = refused_.load(); n > 0)
      notes.push_back("topic '" + spec_.name + "' from DDS: " + std::to_string(n) +
                      " messages were refused, they are no " + spec_.type_name);
    dds_requested_incompatible_qos_status_t status{};
    if (dds_get_requested_incompatible_qos_status(reader_, &status) == DDS_RETCODE_OK &&
        status.total_count > 0)
      notes.push_back(
          "topic '" + spec_.name +
          "' from DDS: a publisher with another QoS was not heard; it must be reliable");
  }

 private:
  std::optional<detail::Envelope> next(bool decode) {
    for (;;) {
      fresh_.store(false);
      void* samples[1] = {nullptr};  // on loan
      dds_sample_info_t info;
      if (dds_take(reader_, samples, &info, 1, 1) != 1) return std::nullopt;
      std::optional<detail::Envelope> envelope;
      if (info.valid_data) envelope = accept(*static_cast<const Message*>(samples[0]), decode);
      (void)dds_return_loan(reader_, samples, 1);
      if (envelope) return envelope;
      if (info.valid_data) refused_.fetch_add(1, std::memory_order_relaxed);
    }
  }
  std::optional<detail::Envelope> accept(const Message& message, bool decode) const {
    const std::size_t limit = spec_.plain_bytes > 0 ? spec_.plain_bytes : spec_.max_bytes;
    if (message.data.length > limit) return std::nullopt;
    detail::Envelope envelope{nullptr, now_ns(), message.number};
    if (!decode) return envelope;
    try {
      envelope.message = spec_.decode({reinterpret_cast<const std::byte*>(message.data.buffer),
                                       static_cast<std::size_t>(message.data.length)});
    } catch (...) {  // not a message of this type
      return std::nullopt;
    }
    return envelope;
  }

  const detail::TopicSpec spec_;
  Doorbell& arrived_;
  dds_entity_t reader_ = 0;
  std::atomic<bool> fresh_{false};
  std::atomic<std::uint64_t> calls_{0};
  std::atomic<std::uint64_t> refused_{0};
};

class DdsBridge final : public Bridge {
 public:
  static Result<std::unique_ptr<Bridge>> open(const BridgeOptions& options) {
    if (options.domain < 0 || options.domain > kMaxDomain)
      return fail(ErrorCode::kInvalid, "DDS domain " + std::to_string(options.domain), {},
                  "from 0 to " + std::to_string(kMaxDomain) + ", see ROS_DOMAIN_ID");
    auto bridge = std::unique_ptr<DdsBridge>(new DdsBridge);
    // What the user says first, then our limit: Cyclone would put together samples of 2 GiB. If
    // the app is in the domain already, by its own means, its configuration holds.
    const char* uri = std::getenv("CYCLONEDDS_URI");
    const std::size_t limit = std::min<std::size_t>(options.largest_bytes + kLeastBytes,
                                                    std::numeric_limits<std::int32_t>::max());
    const std::string config =
        std::string(uri != nullptr && *uri != '\0' ? uri + std::string(",") : "") +
        "<CycloneDDS><Domain id=\"any\"><Internal><MaxSampleSize>" + std::to_string(limit) +
        " B</MaxSampleSize></Internal></Domain></CycloneDDS>";
    const auto domain = static_cast<dds_domainid_t>(options.domain);
    bridge->domain_ = dds_create_domain(domain, config.c_str());
    bridge->participant_ = dds_create_participant(domain, nullptr, nullptr);
    if (bridge->participant_ < 0)
      return fail(ErrorCode::kUnavailable,
                  "cannot join DDS domain " + std::to_string(options.domain) + ": " +
                      reason(bridge->participant_),
                  {}, "CYCLONEDDS_URI must name a network interface that is there");
    bridge->thread_ = std::thread([b = bridge.get()] { b->run(); });
    return bridge;
  }
  ~DdsBridge() override {
    stop();
    if (participant_ > 0) dds_delete(participant_);
    if (domain_ > 0) dds_delete(domain_);
  }

  Result<std::shared_ptr<Publisher>> publish(const detail::TopicSpec& spec) override {
    XAUTO_ASSIGN(const dds_entity_t topic, make_topic(spec));
    const Qos qos(static_cast<std::int32_t>(kBridgeQueue));
    const dds_entity_t writer = dds_create_writer(participant_, topic, qos.qos, nullptr);
    if (writer < 0) return failed("writer", spec, writer);
    auto publisher = std::make_shared<DdsPublisher>(spec, writer, work_);
    const Guard lock(mutex_);
    publishers_.push_back(publisher);
    return publisher;
  }

  Result<std::shared_ptr<Subscriber>> subscribe(const detail::TopicSpec& spec,
                                                Doorbell& arrived) override {
    XAUTO_ASSIGN(const dds_entity_t topic, make_topic(spec));
    auto subscriber = std::make_shared<DdsSubscriber>(spec, arrived);
    const Qos qos(1);
    dds_listener_t* listener = dds_create_listener(subscriber.get());
    dds_lset_data_available(listener, &DdsSubscriber::on_data);
    const dds_entity_t reader = dds_create_reader(participant_, topic, qos.qos, listener);
    dds_delete_listener(listener);
    if (reader < 0) return failed("reader", spec, reader);
    subscriber->read_from(reader);
    const Guard lock(mutex_);
    subscribers_.push_back(subscriber);
    readers_.push_back(reader);
    return subscriber;
  }

  void stop() override {
    if (!thread_.joinable()) return;
    work_->quit.store(true);
    work_->doorbell.ring();
    thread_.join();
    const Guard lock(mutex_);
    for (const dds_entity_t reader : readers_) (void)dds_set_listener(reader, nullptr);
  }

  [[nodiscard]] std::vector<std::string> notes() const override {
    std::vector<std::string> notes;
    const Guard lock(mutex_);
    for (const auto& publisher : publishers_) publisher->note(notes);
    for (const auto& subscriber : subscribers_) subscriber->note(notes);
    return notes;
  }

 private:
  DdsBridge() : work_(std::make_shared<Work>()) {}

  Result<dds_entity_t> make_topic(const detail::TopicSpec& spec) {
    if (!ros_name(spec.name))
      return fail(ErrorCode::kInvalid, "is no name that ROS 2 allows", "topic '" + spec.name + "'",
                  "letters, digits, '_' and '/' between them");
    if (spec.encode == nullptr || spec.decode == nullptr)
      return fail(ErrorCode::kInvalid,
                  "messages of type " + spec.type_name + " cannot leave their process",
                  "topic '" + spec.name + "'", "specialise xauto::Codec for it");
    const dds_entity_t topic = dds_create_topic(participant_, &kMessageType,
                                                ("rt/" + spec.name).c_str(), nullptr, nullptr);
    if (topic < 0) return failed("topic", spec, topic);
    return topic;
  }
  static tl::unexpected<Error> failed(const char* what, const detail::TopicSpec& spec,
                                      dds_return_t code) {
    return fail(ErrorCode::kUnavailable, std::string("DDS has no ") + what + ": " + reason(code),
                "topic '" + spec.name + "'");
  }

  std::vector<std::shared_ptr<DdsPublisher>> publishers() const {
    const Guard lock(mutex_);
    return publishers_;
  }
  void run() {
    rt::set_thread_name("xauto/dds");
    (void)rt::set_other();  // not what the creating thread has: nothing of the app waits for it
    for (;;) {
      const auto all = publishers();
      bool any = false;
      for (const auto& publisher : all) any = publisher->write_one() || any;
      if (any) continue;
      if (work_->quit.load()) break;
      work_->doorbell.wait([&] {
        return !work_->quit.load() &&
               std::all_of(all.begin(), all.end(), [](const auto& p) { return p->empty(); });
      });
    }
    const std::int64_t until = now_ns() + kDrainNs;
    for (const auto& publisher : publishers())
      publisher->finish(std::max<std::int64_t>(0, until - now_ns()));
  }

  dds_entity_t domain_ = 0, participant_ = 0;
  std::shared_ptr<Work> work_;
  std::thread thread_;
  mutable PiMutex mutex_;
  std::vector<std::shared_ptr<DdsPublisher>> publishers_ XAUTO_GUARDED_BY(mutex_);
  std::vector<std::shared_ptr<DdsSubscriber>> subscribers_ XAUTO_GUARDED_BY(mutex_);
  std::vector<dds_entity_t> readers_ XAUTO_GUARDED_BY(mutex_);
};

}  // namespace
}  // namespace xauto::transport

extern "C" const xauto::transport::Plugin xauto_transport_plugin;
const xauto::transport::Plugin xauto_transport_plugin = {
    xauto::transport::kPluginMagic, XAUTO_PLUGIN_BUILD, &xauto::transport::DdsBridge::open};
