// SPDX-License-Identifier: Apache-2.0
// Two modules on a preemptive XPU of the app's own, whose callbacks and jobs do what FAULT says:
//
//   fast, every 20 ms ─► Fast: fast.a, 3 ms
//   slow, every 120 ms ─► Slow: slow.b, 30 ms
//
//   faulty [FAULT]    exec: slow.b's job 5 never returns; suspend-fails, suspend-throws, resume-fails: each time;
//                     suspend-hangs, resume-hangs: the second call never returns
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>

#include <xauto/xauto.h>

using namespace std::chrono_literals;

namespace {

struct Message {
  std::uint64_t k = 0;
};
struct State {
  Message value;
};

[[noreturn]] void never_return() {
  for (;;) std::this_thread::sleep_for(1s);
}

/// What suspends and resumes the work of one XNode, between two slices of 200 us.
class Door {
 public:
  explicit Door(std::string fault) : fault_(std::move(fault)) {}
  xauto::Status suspend() {
    if (fault_ == "suspend-fails") return xauto::fail(xauto::ErrorCode::kIo, "told to");
    if (fault_ == "suspend-throws") throw std::runtime_error("told to");
    if (fault_ == "suspend-hangs" && ++calls_ == 2) never_return();
    return shut(true);
  }
  xauto::Status resume() {
    if (fault_ == "resume-fails") return xauto::fail(xauto::ErrorCode::kIo, "told to");
    if (fault_ == "resume-hangs" && ++calls_ == 2) never_return();
    return shut(false);
  }
  void work(std::chrono::microseconds length) {
    for (auto done = 0us; done < length; done += 260us) {
      {
        std::unique_lock lock(mutex_);
        opened_.wait(lock, [this] { return !shut_; });
      }
      std::this_thread::sleep_for(200us);
    }
  }

 private:
  xauto::Status shut(bool shut) {
    const std::lock_guard lock(mutex_);
    shut_ = shut;
    opened_.notify_all();
    return {};
  }
  const std::string fault_;
  std::atomic<int> calls_{0};
  std::mutex mutex_;
  std::condition_variable opened_;
  bool shut_ = false;
};

}  // namespace

int main(int argc, char** argv) {
  const std::string fault = argc > 1 ? argv[1] : "";
  const xauto::Topic<Message> fast("fast"), slow("slow"), fast_out("fast/out"),
      slow_out("slow/out");
  const xauto::XPU npu("npu");
  Door of_fast(""), of_slow(fault);
  const auto open = [](Door& door) {
    return [&door](const xauto::XpuId&) {
      return xauto::SchedHandle::custom([&door] { return door.suspend(); },
                                        [&door] { return door.resume(); });
    };
  };
  xauto::XNode<State> a("fast.a"), b("slow.b");
  a.add_impl(npu, open(of_fast), [&](State&, const xauto::Input&) { of_fast.work(3ms); });
  b.add_impl(npu, open(of_slow), [&](State&, const xauto::Input& input) {
    if (fault == "exec" && input.sequence() == 5) never_return();
    of_slow.work(30ms);
  });
  xauto::XModule<State> of_a("Fast"), of_b("Slow");
  of_a.add_node(a).add_input_topic(fast).add_output_topic(fast_out, &State::value);
  of_b.add_node(b).add_input_topic(slow).add_output_topic(slow_out, &State::value);
  xauto::App app("faulty");
  app.add_source(fast, 20ms, [](std::uint64_t k) { return Message{k}; });
  app.add_source(slow, 120ms, [](std::uint64_t k) { return Message{k}; });
  app.add_module(of_a).add_module(of_b);
  return app.main(argc, argv);
}
