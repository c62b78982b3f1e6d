// SPDX-License-Identifier: Apache-2.0
// The public App, and the program around it: what a process does that an `xauto` tool has started.
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <thread>

#include <signal.h>
#include <unistd.h>

#include <xauto/app.h>

#include "base/log.h"
#include "base/memory_file.h"
#include "base/pi_mutex.h"
#include "base/rt.h"
#include "emu/client.h"
#include "graph/graph.h"
#include "launch/keeper.h"
#include "model/json.h"
#include "runtime/engine.h"
#include "runtime/profiler.h"
#include "session/notes.h"
#include "session/session.h"

#include "app/run_options.h"

namespace xauto {

namespace {

std::atomic<runtime::Engine*> g_engine{nullptr};
bool g_stuck = false;             // a thread is in an exec for ever: end without its consent
std::atomic<bool> g_stop{false};  // a signal may come before there is an engine to tell

// The first SIGTERM or SIGINT drains; a second one finds the default action restored and stops.
void on_signal(int number) {
  g_stop.store(true);
  if (runtime::Engine* engine = g_engine.load()) engine->request_stop();
  signal(number, SIG_DFL);
}

Result<std::string> answer(const detail::AppSpecErased& app, const runtime::Session& session) {
  switch (session.mode) {
    case runtime::Mode::kDescribe: {
      XAUTO_ASSIGN(const runtime::Graph graph, runtime::Graph::build(app));
      return runtime::describe(graph, session.platform);
    }
    case runtime::Mode::kProfile: {
      XAUTO_ASSIGN(runtime::Profiled profiled, runtime::profile(app, session, g_stop));
      g_stuck = profiled.left_behind;
      return std::move(profiled.text);
    }
    case runtime::Mode::kRun: {
      XAUTO_ASSIGN(auto engine, runtime::Engine::create(app, session));
      g_engine.store(engine.get());
      if (g_stop.load()) engine->request_stop();
      auto report = engine->run();
      g_engine.store(nullptr);
      const bool member = engine->member();
      if (engine->stuck()) {
        g_stuck = true;
        (void)engine.release();
      }
      if (!report) return tl::unexpected<Error>(std::move(report).error());
      if (member) return std::string();  // told to the hub
      return runtime::to_json(*report);
    }
  }
  return fail(ErrorCode::kInternal, "unknown session mode");
}

/// Started by hand: let the tool do what only a parent can, with the same arguments.
int hand_over(char** argv) {
  std::vector<std::string> words = {"xauto", "run", "--", "/proc/self/exe"};
  char path[4096];
  if (const ssize_t length = readlink("/proc/self/exe", path, sizeof path); length > 0)
    words.back() = std::string(path, static_cast<std::size_t>(length));
  for (char** word = argv + 1; *word != nullptr; ++word) words.emplace_back(*word);
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  execvp("xauto", arguments.data());
  log::error("cannot start the xauto tool: {}", strerror(errno));
  log::hint("start this program with `xauto run --app app.json --policy policy.json -- {}`",
            argv[0]);
  return 2;
}

/// Of a program that was started by hand: what it is, and who runs it.
void print_help(const detail::AppSpecErased& app, const char* program) {
  std::string modules, sources;
  const auto add = [](std::string& list, const std::string& name) {
    list += (list.empty() ? "" : ", ") + name;
  };
  for (const auto& module : app.modules) add(modules, module->name);
  for (const detail::SourceSpec& source : app.sources)
    add(sources, source.topic.name + (source.inlet ? " (pushed, at most every " : " (every ") +
                     std::to_string(source.period.count()) + " us)");
  std::printf(
      "%s: an app for XAuto, which schedules its stages over CPUs, GPUs and DLAs.\n\n"
      "  XModules  %s\n  sources   %s\n\n"
      "The xauto tool starts it:\n"
      "  xauto profile --platform small --app-out app.json -- %s\n"
      "  xauto solve --app app.json --platform small --out policy.json\n"
      "  xauto run --app app.json --platform small --policy policy.json -- %s\n\n"
      "What stands behind the program's name there is handed to it. `xauto run --help` has the "
      "flags.\n",
      app.name.c_str(), modules.empty() ? "none" : modules.c_str(),
      sources.empty() ? "none" : sources.c_str(), program, program);
}

bool asks_for_help(char** argv) {
  for (char** word = argv; *word != nullptr; ++word)
    if (std::strcmp(*word, "--help") == 0 || std::strcmp(*word, "-h") == 0) return true;
  return false;
}

}  // namespace

struct App::Data {
  detail::AppSpecErased spec;

  PiMutex mutex;
  enum class Run : std::uint8_t {
    kNone,
    kGoesOn,
    kStuck
  } state XAUTO_GUARDED_BY(mutex) = Run::kNone;
  bool stopped XAUTO_GUARDED_BY(mutex) = false;               ///< the run that goes on
  runtime::Engine* engine XAUTO_GUARDED_BY(mutex) = nullptr;  ///< of that run, once there is one

  void stop() {
    const Guard lock(mutex);
    if (state != Run::kGoesOn) return;
    stopped = true;
    if (engine != nullptr) engine->request_stop();
  }
  Result<RunReport> run(const RunOptions& options, const std::shared_ptr<Data>& self);
  [[nodiscard]] Result<runtime::RunReport> run_engine(const runtime::Session& session,
                                                      const std::shared_ptr<Data>& self);
};

App::App(std::string name) : data_(std::make_shared<Data>()) {
  data_->spec.name = std::move(name);
}
App::~App() = default;

void App::add_module_spec(std::shared_ptr<detail::XModuleSpec> spec) {
  data_->spec.modules.push_back(std::move(spec));
}
void App::add_source_spec(detail::TopicHandle topic, std::chrono::microseconds period,
                          detail::Make make) {
  data_->spec.sources.push_back({*topic, period, std::move(make)});
}
std::shared_ptr<detail::Inlet> App::add_inlet(detail::TopicHandle topic,
                                              std::chrono::microseconds distance) {
  auto inlet = std::make_shared<detail::Inlet>(
      topic->name, std::min<std::int64_t>(distance.count(), kMaxPeriodUs) * 1000);
  data_->spec.sources.push_back({*topic, distance, nullptr, inlet});
  return inlet;
}
void App::add_observer_spec(detail::TopicHandle topic, detail::Observe observe) {
  data_->spec.observers.push_back({*topic, std::move(observe)});
}
App& App::on_start(std::function<void()> callback) {
  data_->spec.on_start.push_back(std::move(callback));
  return *this;
}
App& App::on_stop(std::function<void()> callback) {
  data_->spec.on_stop.push_back(std::move(callback));
  return *this;
}
App& App::on_end(std::function<void()> callback) {
  data_->spec.on_end.push_back(std::move(callback));
  return *this;
}

Status App::check() const {
  XAUTO_TRY(runtime::Graph::build(data_->spec));
  return {};
}

Result<RunReport> App::run(const RunOptions& options) {
  {
    const Guard lock(data_->mutex);
    const std::string where = "app '" + data_->spec.name + "'";
    if (data_->state == Data::Run::kGoesOn)
      return fail(ErrorCode::kUnavailable, "it runs already", where, "two runs need two Apps");
    if (data_->state == Data::Run::kStuck)
      return fail(ErrorCode::kUnavailable, "an exec of its last run never returned", where,
                  "only the end of this process ends its thread");
    data_->state = Data::Run::kGoesOn;
    data_->stopped = false;
  }
  Result<RunReport> report = data_->run(options, data_);
  const Guard lock(data_->mutex);
  if (data_->state == Data::Run::kGoesOn) data_->state = Data::Run::kNone;
  return report;
}

void App::stop() {
  data_->stop();
}

Result<RunReport> App::Data::run(const RunOptions& options, const std::shared_ptr<Data>& self) {
  XAUTO_TRY(runtime::Graph::build(spec));
  XAUTO_ASSIGN(runtime::Session session, options.data_->session());
  XAUTO_ASSIGN(const std::string programs, launch::find_programs(options.data_->programs));
  bool emulator_died = false;
  XAUTO_ASSIGN(const auto keeper, launch::Keeper::start(session, programs, [&] {
                 emulator_died = true;
                 stop();
               }));
  // What contexts find, of this run's threads: other runs of this process have other emulators.
  auto site = std::make_shared<emu::Site>();
  site->address = keeper->emulator();
  for (std::size_t x = 0; x < session.platform.xpus.size(); ++x)
    if (session.presence_of(static_cast<int>(x)) == Presence::kReal)
      site->real.insert(session.platform.xpus[x].id);
  site->cpu_pool = session.scheduling == runtime::Scheduling::kRos2;

  // On a thread of its own, whose name, emulator and priority are nobody else's.
  Result<runtime::RunReport> ran = fail(ErrorCode::kInternal, "not run");
  std::thread([&] {
    emu::set_this_threads_site(site);
    ran = run_engine(session, self);
  }).join();
  std::string died;
  for (const std::string& note : keeper->stop()) runtime::add_note(died, note);
  if (!ran) {
    Error error = std::move(ran).error();
    if (!died.empty()) error.what += "; " + died;
    return tl::unexpected<Error>(std::move(error));
  }
  auto data = std::make_shared<RunReport::Data>();
  data->report = std::move(*ran);
  data->app = spec.name;
  data->emulator_died = emulator_died;
  if (!died.empty()) runtime::add_note(data->report.note, died);
  return RunReport(std::move(data));
}

Result<runtime::RunReport> App::Data::run_engine(const runtime::Session& asked,
                                                 const std::shared_ptr<Data>& self) {
  // Kept for ever if a thread is left behind, which uses it.
  struct Kept {
    std::shared_ptr<Data> app;
    runtime::Session session;
    std::unique_ptr<runtime::Engine> engine;
  };
  auto kept = std::make_unique<Kept>(Kept{self, asked, nullptr});
  XAUTO_ASSIGN(kept->engine, runtime::Engine::create(spec, kept->session));
  {
    const Guard lock(mutex);
    engine = kept->engine.get();
    if (stopped) engine->request_stop();
  }
  auto report = kept->engine->run();
  const Guard lock(mutex);
  engine = nullptr;
  if (kept->engine->stuck()) {
    state = Run::kStuck;
    (void)kept.release();
  }
  return report;
}

int App::main(int, char** argv) {
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);

  const auto session = runtime::inherited_session();
  if (!session) {
    log::error("{}", session.error().to_string());
    return 2;
  }
  if (!session->has_value()) {
    if (const Status good = check(); !good) {
      log::error("{}", good.error().to_string());
      return 2;
    }
    if (asks_for_help(argv)) {
      print_help(data_->spec, argv[0]);
      return 0;
    }
    return hand_over(argv);
  }
  if (const int process = (*session)->process; process != 0)
    rt::set_thread_name("m:" +
                        (*session)->processes[static_cast<std::size_t>(process - 1)].front());
  const auto text = answer(data_->spec, **session);
  int status = text ? 0 : 1;
  if ((*session)->process != 0) {
    if (!text) log::error("{}", text.error().to_string());
  } else {
    const std::string written = text ? *text : runtime::error_to_json(text.error());
    if (const Status done = write_memory_file((*session)->answer_fd, written); !done) {
      log::error("{}", done.error().to_string());
      status = 1;
    }
  }
  if (g_stuck) _exit(status);
  return status;
}

}  // namespace xauto
