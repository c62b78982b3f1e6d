// SPDX-License-Identifier: Apache-2.0
// Topics to and from DDS, in the way of ROS 2: topic NAME is "rt/NAME", of the type that ROS 2 has
// for it (wire.h).
//
//   publisher: publish() ─► a ring per topic ─► thread "xauto/dds" ─► encode ─► dds_writecdr
//   reader:    a thread of Cyclone DDS ─► the newest message waits, the doorbell is rung ─► take()
//
// Nothing from outside can hold up the app, or make it store more than one message per topic (and
// reader: subscriber.h; of what crosses between hosts a few), none of which is larger than the largest of the app.
//
// "xauto/dds" also makes the second readers: Cyclone's own threads must not (subscriber.h).
#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <limits>
#include <map>
#include <set>
#include <string_view>
#include <thread>
#include <utility>

#include <dds/dds.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/pi_mutex.h"
#include "base/rt.h"
#include "base/thread.h"
#include "transport/bridge.h"
#include "transport/cyclonedds/publisher.h"
#include "transport/cyclonedds/sample.h"
#include "transport/cyclonedds/subscriber.h"

namespace xauto::transport {
namespace {

constexpr std::int64_t kBlockingNs = 10'000'000;  ///< dds_write, when a reader does not keep up
constexpr std::int64_t kDrainNs = 1'000'000'000;  ///< of the last messages
constexpr std::size_t kLeastBytes = 64 * 1024;    ///< what DDS says of itself must fit, too
constexpr int kMaxDomain = 232;
constexpr const char* kReceiveBuffer = "16 MB";  ///< as far as net.core.rmem_max lets it

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

/// As ROS 2 has it of these policies, and of all that nobody chooses.
struct Qos {
  Qos(const TopicQos& asked, Reliability reliability, std::int32_t depth) : qos(dds_create_qos()) {
    const bool reliable = asked.reliability.value_or(reliability) == Reliability::kReliable;
    dds_qset_reliability(qos, reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                         kBlockingNs);
    const bool keeps = asked.durability == Durability::kTransientLocal;
    dds_qset_durability(qos, keeps ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, depth);
    if (keeps)
      dds_qset_durability_service(qos, 0, DDS_HISTORY_KEEP_LAST, depth, DDS_LENGTH_UNLIMITED,
                                  DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
    if (asked.deadline_us) dds_qset_deadline(qos, *asked.deadline_us * 1000);
    dds_qset_writer_data_lifecycle(qos, false);
  }
  ~Qos() { dds_delete_qos(qos); }
  Qos(const Qos&) = delete;
  Qos& operator=(const Qos&) = delete;
  dds_qos_t* qos;
};

/// What Cyclone says: a line for each packet that is none of DDS's, and anybody on the network sends those. So a line a
/// second, by a log that nobody waits for. Threads: any. Never destroyed: Cyclone's threads may outlive the bridge.
class CycloneLog {
 public:
  static void take_over() {
    static auto* const log = new CycloneLog;
    dds_set_log_sink(
        [](void* to, const dds_log_data_t* line) { static_cast<CycloneLog*>(to)->tell(*line); },
        log);
  }

 private:
  void tell(const dds_log_data_t& line) {
    std::string_view text(line.message, line.size);
    while (text.ends_with('\n')) text.remove_suffix(1);
    if ((line.priority & DDS_LC_FATAL) != 0) return log::error("Cyclone DDS: {}", text);
    const Guard lock(mutex_);
    lines_.tell(text.substr(0, kLongest), now_ns());
  }

  static constexpr std::size_t kLongest = 200;
  PiMutex mutex_;
  log::Refusals lines_ XAUTO_GUARDED_BY(mutex_){"Cyclone DDS"};
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
    // Before it what it may say better. A message of 6 MB is 500 datagrams in a row, and Cyclone asks
    // for room for 1 MB of them: what then is lost is sent again, after 100 ms where it is the last one.
    const std::string config =
        std::string("<CycloneDDS><Domain id=\"any\"><Internal><SocketReceiveBufferSize max=\"") +
        kReceiveBuffer + "\"/></Internal></Domain></CycloneDDS>," +
        (uri != nullptr && *uri != '\0' ? uri + std::string(",") : "") +
        "<CycloneDDS><Domain id=\"any\"><Internal><MaxSampleSize>" + std::to_string(limit) +
        " B</MaxSampleSize></Internal><SharedMemory><Enable>false</Enable></SharedMemory></Domain>"
        "</CycloneDDS>";
    CycloneLog::take_over();
    const auto domain = static_cast<dds_domainid_t>(options.domain);
    // Cyclone's threads are made here, and inherit what this one has.
    XAUTO_ASSIGN(std::thread maker, start_thread([&] {
                   if (options.enter) options.enter();
                   bridge->domain_ = dds_create_domain(domain, config.c_str());
                   bridge->participant_ = dds_create_participant(domain, nullptr, nullptr);
                 }));
    maker.join();
    if (bridge->participant_ < 0)
      return fail(ErrorCode::kUnavailable,
                  "cannot join DDS domain " + std::to_string(options.domain) + ": " +
                      reason(bridge->participant_),
                  {}, "CYCLONEDDS_URI must name a network interface that is there");
    if (bridge->domain_ < 0 && options.enter)
      bridge->others_ = "DDS's threads are the program's, which had joined domain " +
                        std::to_string(options.domain) +
                        " before: what crosses to other hosts has no priority";
    XAUTO_ASSIGN(bridge->thread_,
                 start_thread([b = bridge.get(), enter = options.enter] { b->run(enter); }));
    return bridge;
  }
  ~DdsBridge() override {
    stop();
    if (participant_ > 0) dds_delete(participant_);
    if (domain_ > 0) dds_delete(domain_);
  }

  Result<std::shared_ptr<Publisher>> publish(const detail::TopicSpec& spec,
                                             const TopicQos& asked) override {
    Wire wire(spec);
    XAUTO_ASSIGN(const Made topic, make_topic(wire));
    const TopicQos resolved = asked.resolved();
    const std::int64_t depth = resolved.depth.value_or(kBridgeQueue);
    const Qos qos(resolved, Reliability::kReliable, static_cast<std::int32_t>(depth));
    const dds_entity_t writer = dds_create_writer(participant_, topic.entity, qos.qos, nullptr);
    if (writer < 0) return failed("writer", spec, writer);
    auto publisher = std::make_shared<DdsPublisher>(std::move(wire), topic.type, writer,
                                                    static_cast<std::size_t>(depth), work_);
    const Guard lock(mutex_);
    publishers_.push_back(publisher);
    return publisher;
  }

  Result<std::shared_ptr<Subscriber>> subscribe(const detail::TopicSpec& spec,
                                                const TopicQos& asked, Doorbell& arrived,
                                                int keeps) override {
    Wire wire(spec);
    auto replaced = std::make_shared<std::atomic<std::uint64_t>>(0);
    XAUTO_ASSIGN(const Made topic, make_topic(wire, replaced));
    auto subscriber =
        std::make_shared<DdsSubscriber>(std::move(wire), arrived, work_, std::move(replaced));
    TopicQos resolved = asked.resolved();
    const bool hears_all = !resolved.reliability;
    resolved.reliability = resolved.reliability.value_or(Reliability::kReliable);
    const dds_entity_t reader = make_reader(topic.entity, resolved, subscriber, hears_all, keeps);
    if (reader < 0) return failed("reader", spec, reader);
    if (hears_all) {
      resolved.reliability = Reliability::kBestEffort;
      const Guard lock(mutex_);
      seconds_.push_back({subscriber, topic.entity, resolved, keeps});
    }
    return subscriber;
  }

  void stop() override {
    if (!thread_.joinable()) return;
    work_->quit.store(true);
    work_->doorbell.ring();
    thread_.join();
    const Guard lock(mutex_);
    for (const auto& [reader, subscriber] : subscribers_) (void)dds_set_listener(reader, nullptr);
  }

  [[nodiscard]] std::vector<std::string> notes() const override {
    std::vector<std::string> notes;
    if (!others_.empty()) notes.push_back(others_);
    const Guard lock(mutex_);
    for (const auto& publisher : publishers_) publisher->note(notes);
    std::set<const DdsSubscriber*> told;
    for (const auto& [reader, subscriber] : subscribers_)
      if (told.insert(subscriber.get()).second) subscriber->note(notes);
    return notes;
  }

 private:
  DdsBridge() : work_(std::make_shared<Work>()) {}

  struct Made {
    dds_entity_t entity;
    const ddsi_sertype* type;  ///< of the topic
  };
  Result<Made> make_topic(const Wire& wire, Replaced replaced = nullptr) {
    const detail::TopicSpec& spec = wire.spec();
    if (!ros_name(spec.name))
      return fail(ErrorCode::kInvalid, "is no name that ROS 2 allows", "topic '" + spec.name + "'",
                  "letters, digits, '_' and '/' between them");
    if (spec.encode == nullptr || spec.decode == nullptr)
      return fail(ErrorCode::kInvalid,
                  "messages of type " + spec.type_name + " cannot leave their process",
                  "topic '" + spec.name + "'", "specialise xauto::Codec for it");
    ddsi_sertype* type = make_type(wire.type_name(), std::move(replaced));
    const dds_entity_t topic = dds_create_topic_sertype(participant_, ("rt/" + spec.name).c_str(),
                                                        &type, nullptr, nullptr, nullptr);
    if (topic < 0) {
      ddsi_sertype_unref(type);
      return failed("topic", spec, topic);
    }
    return Made{topic, type};
  }
  static tl::unexpected<Error> failed(const char* what, const detail::TopicSpec& spec,
                                      dds_return_t code) {
    return fail(ErrorCode::kUnavailable, std::string("DDS has no ") + what + ": " + reason(code),
                "topic '" + spec.name + "'");
  }

  /// Below 0: Cyclone's error. `hears_all`: the subscriber wants to know whom this one does not hear.
  dds_entity_t make_reader(dds_entity_t topic, const TopicQos& asked,
                           const std::shared_ptr<DdsSubscriber>& subscriber, bool hears_all,
                           int keeps) {
    const Qos qos(asked, Reliability::kReliable, keeps);
    dds_listener_t* listener = dds_create_listener(subscriber.get());
    dds_lset_data_available(listener, &DdsSubscriber::on_data);
    if (hears_all) dds_lset_requested_incompatible_qos(listener, &DdsSubscriber::on_misfit);
    const dds_entity_t reader = dds_create_reader(participant_, topic, qos.qos, listener);
    dds_delete_listener(listener);
    if (reader < 0) return reader;
    subscriber->read_from(reader);
    const Guard lock(mutex_);
    subscribers_.emplace(reader, subscriber);  // which it calls from now on
    return reader;
  }
  /// Readers of best effort, of those that have found a publisher for one.
  void make_seconds() {
    std::vector<Second> wanted;
    {
      const Guard lock(mutex_);
      for (const Second& second : seconds_)
        if (second.subscriber->takes_wish()) wanted.push_back(second);
    }
    for (const Second& second : wanted)
      if (make_reader(second.topic, second.qos, second.subscriber, false, second.keeps) < 0)
        log::error("topic '{}': DDS has no second reader: publishers of best effort are not heard",
                   second.subscriber->topic());
  }
  [[nodiscard]] bool wants_second() const {
    const Guard lock(mutex_);
    return std::any_of(seconds_.begin(), seconds_.end(),
                       [](const Second& second) { return second.subscriber->wishes(); });
  }

  std::vector<std::shared_ptr<DdsPublisher>> publishers() const {
    const Guard lock(mutex_);
    return publishers_;
  }
  void run(const std::function<void()>& enter) {
    rt::set_thread_name("xauto/dds");
    (void)rt::set_other();  // not what the creating thread has: nothing of the app waits for it
    if (enter) enter();     // what crosses between hosts does
    for (;;) {
      const auto all = publishers();
      bool any = false;
      for (const auto& publisher : all) any = publisher->write_one() || any;
      make_seconds();
      if (any) continue;
      if (work_->quit.load()) break;
      work_->doorbell.wait([&] {
        return !work_->quit.load() && !wants_second() &&
               std::all_of(all.begin(), all.end(), [](const auto& p) { return p->empty(); });
      });
    }
    const std::int64_t until = now_ns() + kDrainNs;
    for (const auto& publisher : publishers())
      publisher->finish(std::max<std::int64_t>(0, until - now_ns()));
  }

  dds_entity_t domain_ = 0, participant_ = 0;
  std::string others_;  ///< set once
  std::shared_ptr<Work> work_;
  std::thread thread_;
  mutable PiMutex mutex_;
  std::vector<std::shared_ptr<DdsPublisher>> publishers_ XAUTO_GUARDED_BY(mutex_);
  struct Second {
    std::shared_ptr<DdsSubscriber> subscriber;
    dds_entity_t topic = 0;
    TopicQos qos;
    int keeps = 1;
  };
  std::vector<Second> seconds_ XAUTO_GUARDED_BY(mutex_);
  /// By their readers.
  std::map<dds_entity_t, std::shared_ptr<DdsSubscriber>> subscribers_ XAUTO_GUARDED_BY(mutex_);
};

}  // namespace
}  // namespace xauto::transport

extern "C" const xauto::transport::Plugin xauto_transport_plugin;
const xauto::transport::Plugin xauto_transport_plugin = {
    xauto::transport::kPluginMagic, XAUTO_PLUGIN_BUILD, &xauto::transport::DdsBridge::open};
