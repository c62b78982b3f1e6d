// SPDX-License-Identifier: Apache-2.0
#include "app/program.h"

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include <signal.h>
#include <unistd.h>

#include "base/log.h"
#include "base/memory_file.h"
#include "base/rt.h"
#include "graph/deployed.h"
#include "graph/graph.h"
#include "session/session.h"

#include "app/engine_run.h"
#include "profile/profiler.h"

namespace xauto::app {
namespace {

bool g_stuck = false;  // a thread is in an exec for ever: end without its consent
std::atomic<bool> g_stop{false};

// The first SIGTERM or SIGINT drains; a second one finds the default action restored and stops.
void on_signal(int number) {
  g_stop.store(true);
  signal(number, SIG_DFL);
}

Result<std::string> answer(const detail::AppSpecErased& program, const runtime::Session& session) {
  // A run's is for its app.json; before there is one it is for the program.
  if (const std::string& of = session.deployment.app;
      session.mode != runtime::Mode::kRun && !of.empty() && of != program.name)
    return fail(ErrorCode::kInvalid, "is for app '" + of + "', not for '" + program.name + "'",
                "deployment.json");
  XAUTO_ASSIGN(auto deployed, detail::deployed(program, session.deployment));
  // A thread that was left behind may use it until the process ends.
  static std::shared_ptr<const detail::AppSpecErased> held;
  held = std::make_shared<const detail::AppSpecErased>(std::move(deployed));
  const detail::AppSpecErased& app = *held;
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
    case runtime::Mode::kLoad:
      XAUTO_TRY(runtime::load(app, session, g_stop));
      return std::string();
    case runtime::Mode::kRun: {
      Ran ran = run_engine(app, session, g_stop, held);  // the process ends without destructors
      g_stuck = ran.stuck;
      if (!ran.report) return tl::unexpected<Error>(std::move(ran.report).error());
      return ran.member ? std::string() : runtime::to_json(*ran.report);
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
                     source.period.text() + ")");
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

int program(const detail::AppSpecErased& app, char** argv) {
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
    if (const auto good = runtime::Graph::build(app); !good) {
      log::error("{}", good.error().to_string());
      return 2;
    }
    if (asks_for_help(argv)) {
      print_help(app, argv[0]);
      return 0;
    }
    return hand_over(argv);
  }
  if (const int process = (*session)->parts.process; process != 0)
    rt::set_thread_name("m:" +
                        (*session)->parts.modules[static_cast<std::size_t>(process - 1)].front());
  const auto text = answer(app, **session);
  int status = text ? 0 : 1;
  if ((*session)->parts.process != 0 || (*session)->mode == runtime::Mode::kLoad) {
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

}  // namespace xauto::app
