// SPDX-License-Identifier: Apache-2.0
// Cyclone DDS over the loopback interface: reliable, keep last 1, a thread on a waitset. Inside a
// process it delivers without a socket.
#include "peers_cyclone.h"

#include <array>
#include <atomic>
#include <memory>
#include <thread>

#include <dds/dds.h>
#include <sensor_msgs/msg/image.h>

#include "base/futex.h"
#include "transport/bridge.h"

#include "pair.h"
#include "peers.h"

namespace xauto::bench {
namespace {

/// No other machine hears of it.
constexpr const char* kConfig =
    "<CycloneDDS><Domain id=\"any\"><General><Interfaces><NetworkInterface "
    "name=\"lo\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer "
    "address=\"localhost\"/></Peers>"
    "</Discovery></Domain></CycloneDDS>";

class Participant {
 public:
  Participant() {
    setenv("CYCLONEDDS_URI", kConfig, 1);
    entity_ = dds_create_participant(77, nullptr, nullptr);
    qos_ = dds_create_qos();
    dds_qset_reliability(qos_, DDS_RELIABILITY_RELIABLE, DDS_SECS(10));
    dds_qset_history(qos_, DDS_HISTORY_KEEP_LAST, 1);
  }
  ~Participant() {
    dds_delete_qos(qos_);
    dds_delete(entity_);
  }
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;
  [[nodiscard]] bool good() const { return entity_ > 0; }
  dds_entity_t writer(const dds_topic_descriptor_t& type, const std::string& topic) {
    return dds_create_writer(entity_, make(type, topic), qos_, nullptr);
  }
  dds_entity_t reader(const dds_topic_descriptor_t& type, const std::string& topic) {
    const dds_entity_t reader = dds_create_reader(entity_, make(type, topic), qos_, nullptr);
    dds_set_status_mask(reader, DDS_DATA_AVAILABLE_STATUS);
    return reader;
  }
  dds_entity_t waitset() { return dds_create_waitset(entity_); }

 private:
  dds_entity_t make(const dds_topic_descriptor_t& type, const std::string& topic) {
    return dds_create_topic(entity_, &type, topic.c_str(), nullptr, nullptr);
  }
  dds_entity_t entity_;
  dds_qos_t* qos_;
};

void wait_for_reader(dds_entity_t writer) {
  for (dds_publication_matched_status_t status{}; status.current_count == 0; usleep(1000))
    dds_get_publication_matched_status(writer, &status);
}

/// The newest sample, on loan to `use`; false: none.
template <class T, class Use>
bool take(dds_entity_t reader, Use use) {
  void* samples[1] = {nullptr};
  dds_sample_info_t info;
  if (dds_take(reader, samples, &info, 1, 1) != 1) return false;
  if (info.valid_data) use(*static_cast<const T*>(samples[0]));
  dds_return_loan(reader, samples, 1);
  return info.valid_data;
}

}  // namespace

Samples cyclone_dispatch(const Options& options, const Dag& dag) {
  Samples samples;
  (void)rt::pin_to_core(cores().first);
  if (options.fifo) (void)rt::set_fifo(45);
  Participant participant;
  if (!participant.good()) return samples;
  const auto n = static_cast<std::size_t>(dag.nodes);
  struct Edge {
    std::size_t to;
    dds_entity_t writer, reader;
    bool fresh = false;
  };
  std::vector<Edge> edges;
  std::vector<std::vector<std::size_t>> in(n), out(n);
  const auto add = [&](std::size_t to) {
    const std::string topic = "edge" + std::to_string(edges.size());
    edges.push_back({to, participant.writer(xauto_bench_Event_desc, topic),
                     participant.reader(xauto_bench_Event_desc, topic)});
    in[to].push_back(edges.size() - 1);
    return edges.size() - 1;
  };
  const std::size_t trigger = add(0);
  for (std::size_t u = 0; u < n; ++u)
    for (const int v : dag.after[u]) out[u].push_back(add(static_cast<std::size_t>(v)));
  const dds_entity_t waitset = participant.waitset();
  for (std::size_t e = 0; e < edges.size(); ++e)
    dds_waitset_attach(waitset, edges[e].reader, static_cast<dds_attach_t>(e));
  std::atomic<std::uint32_t> done{0};
  std::atomic<bool> quit{false};
  std::thread executor([&] {
    std::vector<dds_attach_t> ready(edges.size());
    std::uint32_t count = 0;
    while (!quit.load()) {
      const auto woken = dds_waitset_wait(waitset, ready.data(), ready.size(), DDS_MSECS(100));
      for (dds_return_t w = 0; w < woken; ++w) {
        Edge& edge = edges[static_cast<std::size_t>(ready[static_cast<std::size_t>(w)])];
        edge.fresh = take<xauto_bench_Event>(edge.reader, [](const auto&) {}) || edge.fresh;
        const std::vector<std::size_t>& inputs = in[edge.to];
        if (!std::all_of(inputs.begin(), inputs.end(),
                         [&](std::size_t e) { return edges[e].fresh; }))
          continue;
        for (const std::size_t e : inputs) edges[e].fresh = false;
        node_body();
        for (const std::size_t e : out[edge.to]) {
          const xauto_bench_Event event{};
          dds_write(edges[e].writer, &event);
        }
        if (edge.to + 1 == n) {
          done.store(++count);
          futex_wake_local(done, 1);
        }
      }
    }
  });
  const xauto_bench_Event event{};
  for (std::uint32_t k = 1; k <= options.rounds; ++k) {
    const std::int64_t start = now_ns();
    dds_write(edges[trigger].writer, &event);
    for (std::uint32_t seen; (seen = done.load()) != k;) futex_wait_local(done, seen);
    samples.add(now_ns() - start);
  }
  quit.store(true);
  executor.join();
  return samples;
}

Samples cyclone_round_trip(const Options& options, int here, int there) {
  const SharedMemory<Shared> shared;
  const pid_t pid = child([&] {
    (void)rt::pin_to_core(there);
    if (options.fifo) (void)rt::set_fifo(60);
    Participant participant;
    const dds_entity_t reader = participant.reader(xauto_bench_Event_desc, "ping");
    const dds_entity_t writer = participant.writer(xauto_bench_Event_desc, "pong");
    const dds_entity_t waitset = participant.waitset();
    dds_waitset_attach(waitset, reader, 0);
    wait_for_reader(writer);
    shared->ready.store(1);
    while (shared->quit.load() == 0) {
      dds_waitset_wait(waitset, nullptr, 0, DDS_MSECS(100));
      take<xauto_bench_Event>(reader, [&](const xauto_bench_Event& e) { dds_write(writer, &e); });
    }
  });
  Samples samples;
  (void)rt::pin_to_core(here);
  if (options.fifo) (void)rt::set_fifo(40);
  Participant participant;
  if (!participant.good()) return samples;
  const dds_entity_t writer = participant.writer(xauto_bench_Event_desc, "ping");
  const dds_entity_t reader = participant.reader(xauto_bench_Event_desc, "pong");
  const dds_entity_t waitset = participant.waitset();
  dds_waitset_attach(waitset, reader, 0);
  wait_for_reader(writer);
  while (shared->ready.load() == 0) usleep(1000);
  for (std::uint32_t k = 1; k <= options.rounds; ++k) {
    xauto_bench_Event event{};
    event.number = k;
    const std::int64_t start = now_ns();
    dds_write(writer, &event);
    for (std::uint32_t got = 0; got != k;) {
      dds_waitset_wait(waitset, nullptr, 0, DDS_MSECS(100));
      take<xauto_bench_Event>(reader, [&](const xauto_bench_Event& e) { got = e.number; });
    }
    samples.add(now_ns() - start);
  }
  (void)rt::set_other();
  shared->quit.store(1);
  waitpid(pid, nullptr, 0);
  return samples;
}

Samples cyclone_transfer(const Options& options, std::size_t bytes, std::uint64_t rounds) {
  const SharedMemory<Shared> shared;
  std::unique_ptr<Participant> participant;
  dds_entity_t writer = 0;
  std::vector<std::uint8_t> data(bytes);
  volatile std::uint64_t sink = 0;
  return measure(
      options, *shared, rounds,
      [&](std::uint32_t k) {
        if (!participant) {  // only now: the receiver must not inherit it
          participant = std::make_unique<Participant>();
          writer = participant->writer(xauto_bench_Blob_desc, "blob");
          wait_for_reader(writer);
        }
        std::fill(data.begin(), data.end(), static_cast<std::uint8_t>(k));
        xauto_bench_Blob blob{};
        blob.data._buffer = data.data();
        blob.data._length = blob.data._maximum = static_cast<std::uint32_t>(bytes);
        const std::int64_t start = now_ns();
        dds_write(writer, &blob);
        return start;
      },
      [&] {
        auto own = std::make_shared<Participant>();
        const dds_entity_t reader = own->reader(xauto_bench_Blob_desc, "blob");
        const dds_entity_t waitset = own->waitset();
        dds_waitset_attach(waitset, reader, 0);
        return [&, own, reader, waitset] {
          dds_waitset_wait(waitset, nullptr, 0, DDS_MSECS(100));
          return take<xauto_bench_Blob>(reader, [&](const xauto_bench_Blob& blob) {
            sink = sink +
                   touch(reinterpret_cast<const std::byte*>(blob.data._buffer), blob.data._length);
            shared->arrived.store(now_ns());
          });
        };
      });
}

// One image from a process to another, by Cyclone's own C type for it and by our plug-in: from dds_write
// or publish until the reader has it as its struct.

Samples cyclone_image(const Options& options, std::size_t bytes, std::uint64_t rounds) {
  const SharedMemory<Shared> shared;
  std::unique_ptr<Participant> participant;
  dds_entity_t writer = 0;
  std::vector<std::uint8_t> data(bytes);
  std::string frame = "camera", encoding = "rgb8";
  volatile std::uint64_t sink = 0;
  return measure(
      options, *shared, rounds,
      [&](std::uint32_t k) {
        if (!participant) {
          participant = std::make_unique<Participant>();
          writer = participant->writer(xauto_bench_Image_desc, "image");
          wait_for_reader(writer);
        }
        std::fill(data.begin(), data.end(), static_cast<std::uint8_t>(k));
        xauto_bench_Image image{};
        image.frame_id = frame.data();
        image.encoding = encoding.data();
        image.data._buffer = data.data();
        image.data._length = image.data._maximum = static_cast<std::uint32_t>(bytes);
        const std::int64_t start = now_ns();
        dds_write(writer, &image);
        return start;
      },
      [&] {
        auto own = std::make_shared<Participant>();
        const dds_entity_t reader = own->reader(xauto_bench_Image_desc, "image");
        const dds_entity_t waitset = own->waitset();
        dds_waitset_attach(waitset, reader, 0);
        return [&, own, reader, waitset] {
          dds_waitset_wait(waitset, nullptr, 0, DDS_MSECS(100));
          return take<xauto_bench_Image>(reader, [&](const xauto_bench_Image& image) {
            sink = sink + touch(reinterpret_cast<const std::byte*>(image.data._buffer),
                                image.data._length);
            shared->arrived.store(now_ns());
          });
        };
      });
}

Samples native_image(const Options& options, std::size_t bytes, std::uint64_t rounds) {
  using sensor_msgs::msg::Image;
  const SharedMemory<Shared> shared;
  setenv("CYCLONEDDS_URI", kConfig, 1);
  const auto spec = *detail::topic_spec(Topic<Image>("image"));
  const auto open = [&] {
    auto bridge = transport::open_bridge("cyclonedds", {.domain = 77, .largest_bytes = 8 << 20});
    if (!bridge) fmt::print(stderr, "bench: {}\n", bridge.error().to_string());
    return std::shared_ptr<transport::Bridge>(bridge ? std::move(*bridge) : nullptr);
  };
  std::shared_ptr<transport::Bridge> here;
  std::shared_ptr<transport::Publisher> publisher;
  const auto image = std::make_shared<Image>();
  image->header.frame_id = "camera";
  image->encoding = "rgb8";
  image->data.resize(bytes);
  volatile std::uint64_t sink = 0;
  return measure(
      options, *shared, rounds,
      [&](std::uint32_t k) {
        if (here == nullptr) {
          here = open();
          if (here == nullptr) std::exit(1);
          publisher = *here->publish(spec, {.depth = 1});  // as Participant
        }
        std::fill(image->data.begin(), image->data.end(), static_cast<std::uint8_t>(k));
        std::int64_t start = now_ns();
        publisher->publish({image, start, k});
        // The first one: until both have found each other.
        for (int waited = 1; k == 0 && shared->done.load() == 0; ++waited) {
          usleep(1000);
          if (waited % 100 == 0) publisher->publish({image, start = now_ns(), k});
        }
        return start;
      },
      [&] {
        const auto there = open();
        if (there == nullptr) std::exit(1);
        const auto doorbell = std::make_shared<transport::Doorbell>();
        const auto subscriber = *there->subscribe(spec, {}, *doorbell);
        return [&, there, doorbell, subscriber] {
          doorbell->wait([&] { return subscriber->empty(); }, 100'000'000);
          const auto envelope = subscriber->take();
          if (!envelope) return false;
          const auto& came = *static_cast<const Image*>(envelope->message.get());
          sink =
              sink + touch(reinterpret_cast<const std::byte*>(came.data.data()), came.data.size());
          shared->arrived.store(now_ns());
          return true;
        };
      });
}

}  // namespace xauto::bench
