// SPDX-License-Identifier: Apache-2.0
#include "profile/corun.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <thread>
#include <utility>

#include <sys/mman.h>
#include <unistd.h>

#include <xauto/emu.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/memory_file.h"
#include "base/pi_mutex.h"
#include "base/process.h"
#include "base/rt.h"
#include "base/thread.h"
#include "graph/graph.h"
#include "model/json.h"

namespace xauto::runtime {
namespace {

/// Whoever takes steps elsewhere is switched on and off by words, in this process or between two.
class Worded : public Load {
 public:
  void off() override {
    want(LoadWords::kOff);
    for (LoadWords* words : words_)
      while (words->idle.load() == 0 && alive()) futex_wait(words->idle, 0);
  }

 protected:
  void want(LoadWords::Wanted wanted) {
    for (LoadWords* words : words_) {
      words->wanted.store(wanted);
      futex_wake(words->wanted, 1);
    }
  }
  /// Until each has taken a step from now on. False: somebody has ended, or `limit_ns` is over.
  bool in_full_swing(std::int64_t limit_ns) {
    std::vector<std::uint32_t> before;
    for (LoadWords* words : words_) before.push_back(words->steps.load());
    want(LoadWords::kOn);
    const std::int64_t until = now_ns() + limit_ns;
    for (std::size_t i = 0; i < words_.size(); ++i)
      while (words_[i]->steps.load() == before[i]) {
        if (!alive() || now_ns() > until) return false;
        futex_wait(words_[i]->steps, before[i]);
      }
    return true;
  }
  virtual bool alive() = 0;

  std::vector<LoadWords*> words_;
};

/// Threads that take one step after the other while they are wanted.
class ThreadLoad : public Worded {
 public:
  using Step = std::function<Status()>;
  using Maker = std::function<Result<Step>()>;  ///< called on the thread, before the first step
  static Result<std::unique_ptr<Load>> begin(const Maker& make, std::size_t count,
                                             const std::vector<int>& cores) {
    auto threads = std::make_unique<ThreadLoad>(count);
    for (Worker& worker : threads->workers_) {
      XAUTO_ASSIGN(worker.thread, start_thread([t = threads.get(), make, cores, &worker] {
                     Status ended = t->run(worker.words, make, cores);
                     if (ended) return;
                     const Guard lock(t->mutex_);
                     t->failed_ = std::move(ended);
                     t->ended_.store(true);
                   }));
    }
    return std::unique_ptr<Load>(std::move(threads));
  }
  explicit ThreadLoad(std::size_t count) : workers_(count) {
    for (Worker& worker : workers_) words_.push_back(&worker.words);
  }
  ~ThreadLoad() override {
    want(LoadWords::kEnd);
    for (Worker& worker : workers_)
      if (worker.thread.joinable()) worker.thread.join();
  }

  Status on(int) override {
    if (in_full_swing(kPatienceNs)) return {};
    const Guard lock(mutex_);
    if (!failed_) return failed_;
    return fail(ErrorCode::kTimeout, "it did not begin");
  }

 private:
  static constexpr std::int64_t kPatienceNs = 60'000'000'000;
  struct Worker {
    LoadWords words{};
    std::thread thread;
  };

  Status run(LoadWords& words, const Maker& make, const std::vector<int>& cores) {
    // What the profiler has made of its own thread is inherited.
    XAUTO_TRY(rt::set_other());
    XAUTO_TRY(rt::pin_to_cores(cores));
    XAUTO_ASSIGN(const Step step, make());
    return serve(words, step, never_);
  }
  bool alive() override { return !ended_.load(); }

  const std::atomic<bool> never_{false};
  std::atomic<bool> ended_{false};  ///< one of them has failed
  PiMutex mutex_;
  Status failed_ XAUTO_GUARDED_BY(mutex_);
  std::vector<Worker> workers_;  ///< last: its threads use the others
};

/// So long a stage waits at most, at its own XPU's next co-run, for the end of the load before.
constexpr auto kEmulatedJob = std::chrono::milliseconds(2);

Result<ThreadLoad::Step> emulated_step(const XpuId& xpu) {
  XAUTO_ASSIGN(auto context, emu::Context::open(xpu));
  return ThreadLoad::Step([shared = std::make_shared<emu::Context>(std::move(context))] {
    return shared->run(kEmulatedJob);
  });
}

/// Far more than a stream may find in a cache that all of them share.
std::size_t bytes_of_stream(std::size_t streams) {
  constexpr std::size_t kLeast = std::size_t{32} << 20, kMost = std::size_t{256} << 20;
  const long cache = sysconf(_SC_LEVEL3_CACHE_SIZE);
  const std::size_t share = cache > 0 ? 4 * static_cast<std::size_t>(cache) / streams : 0;
  return std::clamp(share, kLeast, kMost);
}

Result<ThreadLoad::Step> stream_step(std::size_t streams) {
  rt::set_thread_name("stream");
  const auto words = std::make_shared<std::vector<std::uint64_t>>(bytes_of_stream(streams) /
                                                                  sizeof(std::uint64_t));
  return ThreadLoad::Step([words, at = std::size_t{0}]() mutable -> Status {
    // Every line is read and written, a megabyte per step.
    constexpr std::size_t kWords = (std::size_t{1} << 20) / sizeof(std::uint64_t);
    for (std::size_t i = 0; i < kWords; ++i) (*words)[at + i] += i;
    at = (at + kWords) % words->size();
    return {};
  });
}

/// The program that this process is, with the arguments that it was given.
Result<std::vector<std::string>> own_command() {
  char path[4096];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  std::ifstream file("/proc/self/cmdline", std::ios::binary);
  std::vector<std::string> words;
  for (std::string word; std::getline(file, word, '\0');) words.push_back(word);
  if (length <= 0 || words.empty())
    return fail(ErrorCode::kIo, "does not tell this program's arguments", "/proc/self");
  words.front() = std::string(path, static_cast<std::size_t>(length));
  return words;
}

class ProcessLoad : public Worded {
 public:
  ProcessLoad(Child child, UniqueFd session, UniqueFd memory, LoadWords* words,
              std::vector<int> cores, std::int64_t patience_ns)
      : child_(std::move(child)),
        session_(std::move(session)),
        memory_(std::move(memory)),
        cores_(std::move(cores)),
        patience_ns_(patience_ns) {
    words_.push_back(words);
  }
  ~ProcessLoad() override {
    want(LoadWords::kEnd);
    constexpr int kGraceMs = 1000;
    child_.stop(kGraceMs);
    munmap(words_.front(), sizeof(LoadWords));
  }
  Status on(int not_on) override {
    std::vector<int> cores = cores_;
    if (cores.size() > 1) std::erase(cores, not_on);
    // The thread that calls the app. Where it may have been is no matter of success.
    (void)rt::pin_to_cores(cores, child_.pid());
    if (in_full_swing(patience_ns_)) return {};
    const auto exit = child_.poll();
    return fail(ErrorCode::kUnavailable,
                exit ? "the app's process that should load it ended (" + exit->to_string() + ")"
                     : "the app's process that should load it ran no XNode in time");
  }

 private:
  bool alive() override { return !child_.poll(); }
  Child child_;
  UniqueFd session_, memory_;
  const std::vector<int> cores_;
  const std::int64_t patience_ns_;
};

}  // namespace

Status serve(LoadWords& words, const std::function<Status()>& step, const std::atomic<bool>& stop) {
  for (;;) {
    while (words.wanted.load() == LoadWords::kOff) {
      words.idle.store(1);
      futex_wake(words.idle, 1);
      if (stop.load()) return {};
      futex_wait(words.wanted, LoadWords::kOff);
    }
    if (words.wanted.load() == LoadWords::kEnd || stop.load()) return {};
    words.idle.store(0);
    XAUTO_TRY(step());
    words.steps.fetch_add(1);
    futex_wake(words.steps, 1);
  }
}

Result<LoadWords*> map_load_words(int fd) {
  void* memory = mmap(nullptr, sizeof(LoadWords), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  return static_cast<LoadWords*>(memory);  // a new memfd is zeros, which is what it begins with
}

Result<std::unique_ptr<Load>> load_of_emulated(const XpuId& xpu, const std::vector<int>& cores) {
  // Two take turns: between the end of a job and the next one there is a packet each way, and the XPU
  // would be idle.
  return ThreadLoad::begin([xpu] { return emulated_step(xpu); }, 2, cores);
}

Result<std::unique_ptr<Load>> load_of_core(int core, std::size_t streams) {
  return ThreadLoad::begin([streams] { return stream_step(streams); }, 1, {core});
}

Result<std::unique_ptr<Load>> load_by_the_app(const Session& session, int xpu,
                                              const std::vector<int>& cores) {
  UniqueFd memory = private_memfd("xauto-load", MFD_CLOEXEC);
  if (!memory || ftruncate(memory.get(), sizeof(LoadWords)) != 0)
    return fail(ErrorCode::kIo, std::string("cannot make shared memory: ") + strerror(errno));
  XAUTO_ASSIGN(LoadWords * words, map_load_words(memory.get()));
  Session of_load = session;
  of_load.mode = Mode::kLoad;
  of_load.load.xpu = xpu;
  of_load.load.fd = memory.get();
  of_load.load.cores = cores;
  XAUTO_ASSIGN(UniqueFd file, make_memory_file("xauto-session"));
  XAUTO_ASSIGN(const std::string text, to_json(of_load));
  XAUTO_TRY(write_memory_file(file.get(), text));
  SpawnOptions options;
  XAUTO_ASSIGN(options.argv, own_command());
  options.inherit = {file.get(), memory.get()};
  options.environment = {{kSessionVariable, std::to_string(file.get())}};
  XAUTO_ASSIGN(Child child, Child::spawn(options));
  return std::unique_ptr<Load>(
      std::make_unique<ProcessLoad>(std::move(child), std::move(file), std::move(memory), words,
                                    cores, session.profile.exec_limit_s * 1'000'000'000));
}

std::set<Corun::Loaded> Corun::loaded_by(const std::string& type, const Stage& stage) {
  thread_.check();
  std::set<Loaded> loaded;
  if (type == kEveryType) {
    std::size_t types = 0;
    for (const std::string& each : session_.platform.types()) {
      const std::set<Loaded> of_type = loaded_by(each, stage);
      types += of_type.empty() ? 0 : 1;
      loaded.insert(of_type.begin(), of_type.end());
    }
    if (types >= 2) return loaded;
    why_not_[type] = "no two types can be loaded at once";
    return {};
  }
  const std::vector<Xpu>& xpus = session_.platform.xpus;
  if (!stage.emulated && type == "cpu") {
    for (const int core : cores_)
      if (core != stage.core) loaded.insert({Loaded::Kind::kCore, core});
    if (loaded.empty()) why_not_[type] = "this process may use one core only";
    return loaded;
  }
  bool other = false;
  for (int x = 0; x < static_cast<int>(xpus.size()); ++x) {
    if (x == stage.xpu || xpus[static_cast<std::size_t>(x)].type != type) continue;
    other = true;
    const Presence presence = session_.presence_of(x);
    if (stage.emulated && (presence == Presence::kEmulated || presence == Presence::kEither))
      loaded.insert({Loaded::Kind::kEmulated, x});
    if (!stage.emulated && real_.contains(x)) loaded.insert({Loaded::Kind::kApp, x});
  }
  if (loaded.empty())
    why_not_[type] = !other           ? "there is no second XPU of this type"
                     : stage.emulated ? "the time of a stand-in does not depend on a real XPU"
                                      : "the app computes nothing there that could load it";
  return loaded;
}

void Corun::rest() {
  thread_.check();
  only({}, -1);
}

bool Corun::beside(const std::string& type, const Stage& stage) {
  thread_.check();
  const std::set<Loaded> loaded = loaded_by(type, stage);
  const bool good = !loaded.empty() &&
                    std::none_of(loaded.begin(), loaded.end(),
                                 [&](const Loaded& one) { return failed_.contains(one); }) &&
                    only(loaded, stage.core);
  if (!good) {
    rest();
    return false;
  }
  for (const Loaded& one : loaded) what_[type].insert(one.kind);
  return true;
}

std::string Corun::what(const std::string& type) const {
  thread_.check();
  std::string all;
  const auto kinds = what_.find(type);
  if (kinds == what_.end()) return all;
  for (const Loaded::Kind kind : kinds->second) {
    if (!all.empty()) all += "; ";
    switch (kind) {
      case Loaded::Kind::kEmulated:
        all += "emulated jobs without a pause";
        break;
      case Loaded::Kind::kCore:
        all += "memory streams on the other cores";
        break;
      case Loaded::Kind::kApp:
        all += "the app's own XNodes there, in turn, in another process";
        break;
    }
  }
  return all;
}

std::string Corun::failure(const std::string& type) const {
  thread_.check();
  for (const auto& [one, why] : failed_) {
    const bool core = one.kind == Loaded::Kind::kCore;
    const std::vector<Xpu>& xpus = session_.platform.xpus;
    if (type == kEveryType ||
        (core ? type == "cpu" : xpus[static_cast<std::size_t>(one.number)].type == type))
      return why;
  }
  return {};
}

std::string Corun::why_not(const std::string& type) const {
  thread_.check();
  const auto at = why_not_.find(type);
  return at == why_not_.end() ? "the app has nothing to measure beside it" : at->second;
}

Result<std::unique_ptr<Load>> Corun::make(const Loaded& one) const {
  switch (one.kind) {
    case Loaded::Kind::kEmulated:
      return load_of_emulated(xpu_id(session_.platform, one.number), cores_);
    case Loaded::Kind::kCore:
      return load_of_core(one.number, cores_.size());
    case Loaded::Kind::kApp:
      return load_by_the_app(session_, one.number, cores_);
  }
  return fail(ErrorCode::kInternal, "no such load");
}

bool Corun::only(const std::set<Loaded>& wanted, int not_on) {
  for (auto at = on_.begin(); at != on_.end();) {
    if (wanted.contains(*at)) {
      ++at;
      continue;
    }
    loads_.at(*at)->off();
    at = on_.erase(at);
  }
  for (const Loaded& one : wanted) {
    if (on_.contains(one)) continue;
    std::unique_ptr<Load>& load = loads_[one];
    Status begun;
    if (!load) {
      if (auto made = make(one))
        load = std::move(*made);
      else
        begun = tl::unexpected<Error>(std::move(made).error());
    }
    if (begun) begun = load->on(not_on);
    if (!begun) {
      failed_[one] = begun.error().what.substr(0, kMaxNameBytes);
      loads_.erase(one);
      return false;
    }
    on_.insert(one);
  }
  return true;
}

}  // namespace xauto::runtime
