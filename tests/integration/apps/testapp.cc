// SPDX-License-Identifier: Apache-2.0
// An app for the integration tests: its results are numbers that depend on every message, so that
// two ways of running it can be compared, and it fails where it is told to.
//
//   src ─┬─► A (a1 cpu, a2 npu; plain data) ─┐
//        ├─► B (b1 npu; a string)  ──────────┴─► C (c1 cpu) ─► result, written to FILE at the end
//        └─► D (d1 cpu) ─► aside: not affected by what happens to the others
//
//   testapp FILE [crash|hang|throw|slow|early|batch|thread|child|exit MODULE K [MS]] [period US] [tally] [times]
//           [emulated US] [filelimit BYTES] [room N]
//
// `slow`: every job takes MS longer, `early`: those before K. In job K `batch` changes its thread's scheduling
// policy, `thread` and `child` leave something behind that computes for MS.
// With `filelimit` no file of it grows beyond that once messages come: a disk that gets full.
// With `emulated` every XNode has a context of the emulator's and first takes so long on it.
// With `room` each module may have so many activations at once.
// With `tally` FILE gets one line per topic instead of one per message, so that a soak's own memory
// does not grow: TOPIC MESSAGES FIRST LAST DISORDER CHECKSUM. With `times` the values of topic d
// are not results but when: the release in us of CLOCK_MONOTONIC, shifted left by 24, and the
// latency of D from there in us. For bench/runtime/kills.py.
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <sched.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include <xauto/emu.h>
#include <xauto/xauto.h>

namespace {

struct Block {
  std::array<std::uint64_t, 512> words;
};

struct Fault {
  std::string kind, module;
  std::uint64_t at = 0;
  int ms = 0;
} g_fault;

std::chrono::microseconds g_emulated{0};  ///< work of each XNode on the emulator; 0: none

std::uint64_t mix(std::uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9u;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebu;
  return x ^ x >> 31;
}

Block make_block(std::uint64_t seed) {
  Block block;
  for (std::size_t i = 0; i < block.words.size(); ++i) block.words[i] = mix(seed + i);
  return block;
}

std::uint64_t sum(const Block& block) {
  std::uint64_t total = 0;
  for (const std::uint64_t word : block.words) total = mix(total + word);
  return total;
}

void misbehave(const std::string& module, std::uint64_t k) {
  if (g_fault.module != module) return;
  if (g_fault.kind == "slow" || (g_fault.kind == "early" && k < g_fault.at))
    std::this_thread::sleep_for(std::chrono::milliseconds(g_fault.ms));
  if (k != g_fault.at) return;
  const auto compute = [ms = g_fault.ms] {
    for (timespec used{}; used.tv_sec * 1000 + used.tv_nsec / 1'000'000 < ms;)
      clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
  };
  if (const sched_param none{}; g_fault.kind == "batch") sched_setscheduler(0, SCHED_BATCH, &none);
  if (g_fault.kind == "thread") std::thread(compute).detach();
  if (g_fault.kind == "child" && fork() == 0) {
    compute();
    _exit(0);
  }
  if (g_fault.kind == "crash") std::abort();
  if (g_fault.kind == "throw") throw std::runtime_error("told to");
  if (g_fault.kind == "hang") std::this_thread::sleep_for(std::chrono::milliseconds(g_fault.ms));
}

struct State {
  std::uint64_t value = 0;
  Block block{};
  std::string text;
};

std::uint64_t when(std::chrono::nanoseconds origin) {
  const auto now = std::chrono::steady_clock::now().time_since_epoch();
  const auto us = [](auto t) {
    return static_cast<std::uint64_t>(
        std::chrono::duration_cast<std::chrono::microseconds>(t).count());
  };
  return us(origin) << 24 | std::min<std::uint64_t>(us(now - origin), (1u << 24) - 1);
}

struct Tally {
  std::uint64_t messages = 0, first = 0, last = 0, disorder = 0, checksum = 0;
  void add(std::uint64_t value, std::uint64_t k) {
    if (messages++ == 0)
      first = k;
    else if (k <= last)
      ++disorder;
    last = k;
    checksum += mix(value ^ mix(k));
  }
};

template <class Exec>
xauto::XNode<State> node(const std::string& name, const std::string& xpu, const std::string& module,
                         Exec exec) {
  using Context = std::optional<xauto::emu::Context>;
  xauto::XNode<State> made(name);
  made.add_impl(
      xauto::XPU(xpu),
      [module](const xauto::XpuId& id) {
        if (g_fault.kind == "exit" && g_fault.module == module) std::_Exit(3);
        auto context = std::make_unique<Context>();
        if (g_emulated.count() == 0)
          return xauto::own(std::move(context), xauto::SchedHandle::gate());
        auto opened = xauto::emu::Context::open(id);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        context->emplace(std::move(*opened));
        const xauto::SchedHandle handle = (*context)->handle();
        return xauto::own(std::move(context), handle);
      },
      [module, exec](Context& context, State& state, const xauto::Input& input) {
        misbehave(module, input.sequence());
        if (context)
          if (const xauto::Status done = context->run(g_emulated); !done)
            throw std::runtime_error(done.error().to_string());
        exec(state, input);
      });
  return made;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "/dev/null";
  std::chrono::microseconds period{2000};
  rlim_t file_limit = RLIM_INFINITY;
  bool tallied = false, timed = false;
  int in_flight = 1;
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "filelimit" && i + 1 < argc) {
      file_limit = std::strtoull(argv[++i], nullptr, 10);
    } else if (word == "room" && i + 1 < argc) {
      in_flight = std::atoi(argv[++i]);
    } else if (word == "emulated" && i + 1 < argc) {
      g_emulated = std::chrono::microseconds(std::atoll(argv[++i]));
    } else if (word == "period" && i + 1 < argc) {
      period = std::chrono::microseconds(std::atoll(argv[++i]));
    } else if (word == "tally") {
      tallied = true;
    } else if (word == "times") {
      timed = true;
    } else if (i + 2 < argc) {
      g_fault = {word, argv[i + 1], std::strtoull(argv[i + 2], nullptr, 10), 0};
      i += 2;
      if (i + 1 < argc && std::atoi(argv[i + 1]) > 0) g_fault.ms = std::atoi(argv[++i]);
    }
  }

  const xauto::Topic<Block> source("src"), a("a");
  const xauto::Topic<std::string> b("b");
  const xauto::Topic<std::uint64_t> c("c"), d("d");
  xauto::App app("testapp");
  app.add_source(source, period, [file_limit](std::uint64_t k) {
    if (k == 1 && file_limit != RLIM_INFINITY) {
      std::signal(SIGXFSZ, SIG_IGN);
      const rlimit limit{file_limit, RLIM_INFINITY};
      setrlimit(RLIMIT_FSIZE, &limit);
    }
    return make_block(k);
  });

  xauto::XModule<State> A("A"), B("B"), C("C"), D("D");
  A.add_node(node("a1", "cpu", "A",
                  [source](State& s, const xauto::Input& in) { s.value = sum(in.get(source)); }))
      .add_node(node("a2", "npu", "A",
                     [](State& s, const xauto::Input&) { s.block = make_block(s.value); }))
      .add_input_topic(source)
      .add_output_topic(a, &State::block);
  B.add_node(node("b1", "npu", "B",
                  [source](State& s, const xauto::Input& in) {
                    s.text = std::to_string(sum(in.get(source)) ^ 0x5555) +
                             std::string(in.sequence() % 97, 'b');
                  }))
      .add_input_topic(source)
      .add_output_topic(b, &State::text);
  C.add_node(node("c1", "cpu", "C",
                  [a, b](State& s, const xauto::Input& in) {
                    s.value = sum(in.get(a));
                    for (const char x : in.get(b))
                      s.value = mix(s.value + static_cast<unsigned char>(x));
                  }))
      .add_input_topic(a)
      .add_input_topic(b)
      .add_output_topic(c, &State::value);
  D.add_node(node("d1", "cpu", "D",
                  [source, timed](State& s, const xauto::Input& in) {
                    s.value = sum(in.get(source));
                    if (timed) s.value = when(in.origin());
                  }))
      .add_input_topic(source)
      .add_output_topic(d, &State::value);
  for (xauto::XModule<State>* module : {&A, &B, &C, &D})
    app.add_module(module->in_flight(in_flight));

  std::mutex mutex;
  std::deque<std::string> lines;  // a vector that grows moves 32 768 of them in one job's time
  std::map<std::string, Tally> tallies;
  const auto keep = [&](const char* topic) {
    return [&, topic](const std::uint64_t& value, std::uint64_t k) {
      const std::lock_guard lock(mutex);
      if (tallied) return tallies[topic].add(value, k);
      lines.push_back(std::string(topic) + " " + std::to_string(k) + " " + std::to_string(value));
    };
  };
  app.on_message(c, keep("c")).on_message(d, keep("d"));
  app.on_end([&] {
    std::ofstream out(file);
    std::stable_sort(lines.begin(), lines.end(),
                     [](const auto& x, const auto& y) { return x[0] < y[0]; });
    for (const std::string& line : lines) out << line << "\n";
    for (const auto& [topic, t] : tallies)
      out << topic << " " << t.messages << " " << t.first << " " << t.last << " " << t.disorder
          << " " << t.checksum << "\n";
  });
  return app.main(argc, argv);
}
