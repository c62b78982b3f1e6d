// SPDX-License-Identifier: Apache-2.0
// xauto: one tool, one verb per step. Each verb is in cmd_<verb>.cc.
#include <signal.h>

#include "base/process.h"

#include "xauto/command.h"

int main(int argc, char** argv) {
  xauto::open_standard_streams();
  signal(SIGXFSZ, SIG_IGN);  // past `ulimit -f` a write fails, and is told
  xauto::cli::Program program(
      "XAuto: schedule the stages of a perception stack over CPUs, GPUs and DLAs.", "xauto");
  xauto::cli::Commands commands(program);
  xauto::cli::add_doctor(commands);
  xauto::cli::add_generate(commands);
  xauto::cli::add_import(commands);
  xauto::cli::add_whatif(commands);
  xauto::cli::add_split(commands);
  xauto::cli::add_profile(commands);
  xauto::cli::add_graph(commands);
  xauto::cli::add_solve(commands);
  xauto::cli::add_explain(commands);
  xauto::cli::add_simulate(commands);
  xauto::cli::add_check(commands);
  xauto::cli::add_run(commands);
  xauto::cli::add_compare(commands);
  xauto::cli::add_report(commands);
  xauto::cli::add_top(commands);
  xauto::cli::add_monitor(commands);
  xauto::cli::add_param(commands);
  xauto::cli::add_prio(commands);
  xauto::cli::add_recording(commands);
  return commands.run(argc, argv);
}
