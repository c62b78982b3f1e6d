// SPDX-License-Identifier: Apache-2.0
// iceoryx: loaned chunks, a thread on a waitset. Its daemon, RouDi, is started for each row with
// pools of the sizes that are needed, and stopped after it.
#include <array>
#include <atomic>
#include <fstream>
#include <memory>
#include <thread>

#include <iceoryx_hoofs/log/logmanager.hpp>
#include <iceoryx_posh/popo/publisher.hpp>
#include <iceoryx_posh/popo/subscriber.hpp>
#include <iceoryx_posh/popo/untyped_publisher.hpp>
#include <iceoryx_posh/popo/untyped_subscriber.hpp>
#include <iceoryx_posh/popo/wait_set.hpp>
#include <iceoryx_posh/runtime/posh_runtime.hpp>
#include <sys/socket.h>
#include <sys/un.h>

#include "base/futex.h"
#include "base/process.h"

#include "pair.h"
#include "peers.h"

namespace xauto::bench {
namespace {

using iox::popo::SubscriberState;
using iox::popo::UntypedPublisher;
using iox::popo::UntypedSubscriber;
using WaitSet = iox::popo::WaitSet<128>;

struct Event {
  std::uint32_t number;
  std::uint8_t bytes[60];
};

/// The daemon; on the second core, where it sleeps but for its rounds ten times a second.
class RouDi {
 public:
  RouDi() {
    if (connects()) {
      fmt::print(stderr, "bench: another iox-roudi is running; stop it first\n");
      return;
    }
    char path[] = "/tmp/xauto-bench-roudi.XXXXXX";
    const int fd = mkstemp(path);
    if (fd < 0) return;
    close(fd);
    config_ = path;
    std::ofstream file(config_);
    file << "[general]\nversion = 1\n[[segment]]\n";
    for (const auto& [size, count] :
         {std::pair{128, 4000}, {2048, 64}, {(1 << 20) + 1024, 16}, {(6 << 20) + 1024, 16}})
      file << "[[segment.mempool]]\nsize = " << size << "\ncount = " << count << "\n";
    file.close();
    auto spawned = Child::spawn(
        {.argv = {"/bin/sh", "-c", "exec iox-roudi -c '" + config_ + "' -l off >/dev/null 2>&1"},
         .inherit = {},
         .environment = {}});
    if (!spawned) return;
    child_ = std::move(*spawned);
    for (int i = 0; i < 1000 && child_.running() && !connects(); ++i) {
      usleep(10'000);
      (void)child_.poll();
    }
    good_ = child_.running();
    if (!good_) fmt::print(stderr, "bench: iox-roudi did not start\n");
  }
  ~RouDi() {
    child_.stop(5000);
    if (!config_.empty()) unlink(config_.c_str());
  }
  RouDi(const RouDi&) = delete;
  RouDi& operator=(const RouDi&) = delete;
  [[nodiscard]] bool good() const { return good_; }

 private:
  /// Whether somebody listens on RouDi's socket; a file alone may be left by one that was killed.
  static bool connects() {
    const int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::snprintf(address.sun_path, sizeof address.sun_path, "/tmp/roudi");
    const bool answers =
        connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
    close(fd);
    return answers;
  }
  std::string config_;
  Child child_;
  bool good_ = false;
};

void join(const char* name) {
  iox::log::LogManager::GetLogManager().SetDefaultLogLevel(iox::log::LogLevel::kError,
                                                           iox::log::LogLevelOutput::kHideLogLevel);
  iox::runtime::PoshRuntime::initRuntime(iox::RuntimeName_t(iox::cxx::TruncateToCapacity, name));
}

iox::capro::ServiceDescription topic(const std::string& name) {
  return {"XAutoBench", "topic", iox::capro::IdString_t(iox::cxx::TruncateToCapacity, name)};
}

template <class Publisher>
void wait_for_reader(const Publisher& publisher) {
  while (!publisher.hasSubscribers()) usleep(1000);
}

Samples dispatch(const Options& options, const Dag& dag) {
  Samples samples;
  (void)rt::pin_to_core(cores().first);
  if (options.fifo) (void)rt::set_fifo(45);
  join("xauto-bench-dispatch");
  const auto n = static_cast<std::size_t>(dag.nodes);
  using Publisher = iox::popo::Publisher<Event>;
  using Subscriber = iox::popo::Subscriber<Event>;
  struct Edge {
    std::size_t to;
    std::unique_ptr<Publisher> writer;
    std::unique_ptr<Subscriber> reader;
    bool fresh = false;
  };
  std::vector<Edge> edges;
  std::vector<std::vector<std::size_t>> in(n), out(n);
  const auto add = [&](std::size_t to) {
    const auto description = topic("edge" + std::to_string(edges.size()));
    iox::popo::SubscriberOptions queue;
    queue.queueCapacity = 1;
    edges.push_back({to, std::make_unique<Publisher>(description),
                     std::make_unique<Subscriber>(description, queue)});
    in[to].push_back(edges.size() - 1);
    return edges.size() - 1;
  };
  const std::size_t trigger = add(0);
  for (std::size_t u = 0; u < n; ++u)
    for (const int v : dag.after[u]) out[u].push_back(add(static_cast<std::size_t>(v)));
  const auto waitset = std::make_unique<WaitSet>();
  for (std::size_t e = 0; e < edges.size(); ++e) {
    wait_for_reader(*edges[e].writer);
    if (waitset->attachState(*edges[e].reader, SubscriberState::HAS_DATA, e).has_error())
      return samples;
  }
  const auto send = [](Publisher& writer) {
    auto sample = writer.loan();
    if (sample.has_error()) std::abort();
    sample.value().publish();
  };
  std::atomic<std::uint32_t> done{0};
  std::atomic<bool> quit{false};
  std::thread executor([&] {
    std::uint32_t count = 0;
    while (!quit.load()) {
      const auto ready = waitset->timedWait(iox::units::Duration::fromMilliseconds(100));
      for (const auto* notification : ready) {
        Edge& edge = edges[notification->getNotificationId()];
        edge.fresh = !edge.reader->take().has_error() || edge.fresh;
        const std::vector<std::size_t>& inputs = in[edge.to];
        if (!std::all_of(inputs.begin(), inputs.end(),
                         [&](std::size_t e) { return edges[e].fresh; }))
          continue;
        for (const std::size_t e : inputs) edges[e].fresh = false;
        node_body();
        for (const std::size_t e : out[edge.to]) send(*edges[e].writer);
        if (edge.to + 1 == n) {
          done.store(++count);
          futex_wake_local(done, 1);
        }
      }
    }
  });
  for (std::uint32_t k = 1; k <= options.rounds; ++k) {
    const std::int64_t start = now_ns();
    send(*edges[trigger].writer);
    for (std::uint32_t seen; (seen = done.load()) != k;) futex_wait_local(done, seen);
    samples.add(now_ns() - start);
  }
  quit.store(true);
  executor.join();
  (void)rt::set_other();
  return samples;
}

Samples round_trip(const Options& options, int here, int there) {
  Samples samples;
  const SharedMemory<Shared> shared;
  const pid_t pid = child([&] {
    (void)rt::pin_to_core(there);
    if (options.fifo) (void)rt::set_fifo(60);
    join("xauto-bench-server");
    iox::popo::Subscriber<Event> reader(topic("ping"));
    iox::popo::Publisher<Event> writer(topic("pong"));
    WaitSet waitset;
    (void)waitset.attachState(reader, SubscriberState::HAS_DATA).has_error();
    wait_for_reader(writer);
    shared->ready.store(1);
    while (shared->quit.load() == 0) {
      (void)waitset.timedWait(iox::units::Duration::fromMilliseconds(100));
      auto got = reader.take();
      if (got.has_error()) continue;
      auto reply = writer.loan();
      if (reply.has_error()) continue;
      *reply.value() = **got;
      reply.value().publish();
    }
  });
  (void)rt::pin_to_core(here);
  if (options.fifo) (void)rt::set_fifo(40);
  join("xauto-bench-client");
  {
    iox::popo::Publisher<Event> writer(topic("ping"));
    iox::popo::Subscriber<Event> reader(topic("pong"));
    WaitSet waitset;
    (void)waitset.attachState(reader, SubscriberState::HAS_DATA).has_error();
    wait_for_reader(writer);
    while (shared->ready.load() == 0) usleep(1000);
    for (std::uint32_t k = 1; k <= options.rounds; ++k) {
      const std::int64_t start = now_ns();
      auto event = writer.loan();
      if (event.has_error()) break;
      event.value()->number = k;
      event.value().publish();
      for (std::uint32_t number = 0; number != k;) {
        (void)waitset.timedWait(iox::units::Duration::fromMilliseconds(100));
        if (auto got = reader.take(); !got.has_error()) number = (*got)->number;
      }
      samples.add(now_ns() - start);
    }
    (void)rt::set_other();
    shared->quit.store(1);
    waitpid(pid, nullptr, 0);
  }
  return samples;
}

Samples transfer(const Options& options, std::size_t bytes, std::uint64_t rounds) {
  const SharedMemory<Shared> shared;
  std::unique_ptr<UntypedPublisher> writer;
  volatile std::uint64_t sink = 0;
  Samples samples = measure(
      options, *shared, rounds,
      [&](std::uint32_t k) {
        if (!writer) {  // only now: the receiver must not inherit it
          join("xauto-bench-sender");
          writer = std::make_unique<UntypedPublisher>(topic("blob"));
          wait_for_reader(*writer);
        }
        auto room = writer->loan(static_cast<std::uint32_t>(bytes), 64);
        if (room.has_error()) std::abort();
        auto* at = static_cast<std::byte*>(room.value());
        std::fill(at, at + bytes, static_cast<std::byte>(k));
        const std::int64_t start = now_ns();
        writer->publish(at);
        return start;
      },
      [&] {
        join("xauto-bench-receiver");
        struct Reader {
          UntypedSubscriber subscriber{topic("blob")};
          WaitSet waitset;
        };
        auto reader = std::make_shared<Reader>();
        (void)reader->waitset.attachState(reader->subscriber, SubscriberState::HAS_DATA)
            .has_error();
        return [&, reader] {
          (void)reader->waitset.timedWait(iox::units::Duration::fromMilliseconds(100));
          auto got = reader->subscriber.take();
          if (got.has_error()) return false;
          sink = sink + touch(static_cast<const std::byte*>(got.value()), bytes);
          shared->arrived.store(now_ns());
          reader->subscriber.release(got.value());
          return true;
        };
      });
  return samples;
}

/// RouDi, and who talks to it in a process that ends before it: it kills whoever is still there.
Samples beside_roudi(const std::function<Samples()>& body) {
  const RouDi roudi;
  return roudi.good() ? in_process("iceoryx", body) : Samples{};
}

}  // namespace

Samples iceoryx_dispatch(const Options& options, const Dag& dag) {
  return beside_roudi([&] { return dispatch(options, dag); });
}
Samples iceoryx_round_trip(const Options& options, int here, int there) {
  return beside_roudi([&] { return round_trip(options, here, there); });
}
Samples iceoryx_transfer(const Options& options, std::size_t bytes, std::uint64_t rounds) {
  return beside_roudi([&] { return transfer(options, bytes, rounds); });
}

}  // namespace xauto::bench
