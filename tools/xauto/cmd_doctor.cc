// SPDX-License-Identifier: Apache-2.0
// xauto doctor: what this machine offers, and what to do about each thing that is missing.
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <set>

#include <fmt/format.h>

#include "base/columns.h"
#include "kernel/probe.h"
#include "launch/clock_watch.h"
#include "model/json.h"
#include "model/json_value.h"
#include "processes/marks.h"
#include "xpu/presence.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

/// A platform file of this machine, for the XNodes that compute themselves.
Status write_platform(const std::string& path) {
  const xpu::Hardware machine = xpu::Hardware::here();
  return write_file(path, to_json(platform_of(machine, "here")));
}

/// Runs that have real XPUs now: another one with the same would break their claims, and they its.
kernel::Finding who_has_xpus() {
  std::map<std::string, std::string> of_run;
  for (const runtime::Holder& holder : runtime::holders({})) {
    std::string& list = of_run[holder.words()];
    list += (list.empty() ? "" : ", ") + holder.hardware;
  }
  kernel::Finding finding{
      "in use", kernel::Verdict::kOk, "no run that is seen from here has a real XPU", {}, {}};
  finding.meaning = "a claim takes for granted that each XPU serves one app alone";
  if (of_run.empty()) return finding;
  finding.verdict = kernel::Verdict::kDegraded;
  finding.found.clear();
  for (const auto& [run, list] : of_run)
    finding.found += (finding.found.empty() ? "" : "; ") + run + " has " + list;
  finding.advice = "run an app with claims on other XPUs, or when these are over";
  return finding;
}

/// Programs that discipline clocks, of those that run.
std::string who_disciplines() {
  // As /proc/PID/comm has them: 15 letters.
  const std::set<std::string> known = {"chronyd", "ptp4l",           "phc2sys", "ntpd",
                                       "ntp-rs",  "systemd-timesyn", "ts2phc",  "timemaster"};
  std::set<std::string> running;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc", error)) {
    std::ifstream file(entry.path() / "comm");
    if (std::string comm; std::getline(file, comm) && known.contains(comm)) running.insert(comm);
  }
  std::string list;
  for (const std::string& one : running) list += (list.empty() ? "" : ", ") + one;
  return list;
}

/// How far this host's clock may be from others', of an app over several.
kernel::Finding how_the_clock_goes() {
  kernel::Finding finding{"clock",
                          kernel::Verdict::kOk,
                          {},
                          "parts of an app on several computers start together, and keep X",
                          {}};
  const auto state = launch::clock_state();
  const std::string who = who_disciplines();
  finding.found = who.empty() ? "nobody that is known disciplines it" : "disciplined by " + who;
  if (state)
    finding.found += fmt::format(
        "; {}, maximum error {} us, estimated {} us, rate corrected by {:.3f} ppm, TAI - UTC = {} "
        "s",
        state->synchronised ? "synchronised" : "the kernel calls it not synchronised",
        state->max_error_us, state->estimated_error_us, state->rate_ppm, state->tai_s);
  if (state && state->synchronised && !who.empty()) return finding;
  finding.verdict = kernel::Verdict::kDegraded;
  finding.meaning =
      "no matter on one computer; on several nothing keeps the clocks within X of each other";
  finding.advice =
      "for an app on several: linuxptp (ptp4l, phc2sys) or chrony on each "
      "(docs/several-machines.md)";
  return finding;
}

Result<int> doctor(const std::string& platform_out, const Options& options) {
  if (!platform_out.empty()) XAUTO_TRY(write_platform(platform_out));
  using kernel::Verdict;
  auto findings = kernel::probe("", kernel::Permitted::of_this_process(), xpu::devices());
  findings.push_back(who_has_xpus());
  findings.push_back(how_the_clock_goes());
  const auto word = [](Verdict v) {
    return v == Verdict::kOk ? "ok" : v == Verdict::kDegraded ? "degraded" : "missing";
  };
  if (options.json) {
    Json list = Json::array();
    for (const kernel::Finding& f : findings)
      list.push_back({{"id", f.id},
                      {"state", word(f.verdict)},
                      {"found", f.found},
                      {"meaning", f.meaning},
                      {"advice", f.advice}});
    std::cout << Json{{"findings", std::move(list)}}.dump(2) << "\n";
    return kDone;
  }
  for (const kernel::Finding& f : findings) {
    std::cout << wrapped(fmt::format("  {:<9} {:<14} {}", word(f.verdict), f.id, f.found), 27)
              << "\n"
              << wrapped("            " + f.meaning, 12) << "\n";
    if (!f.advice.empty()) std::cout << wrapped("            -> " + f.advice, 15) << "\n";
  }
  return kDone;
}

}  // namespace

void add_doctor(Commands& commands) {
  auto platform_out = std::make_shared<std::string>();
  Verb verb = commands.add(
      "doctor", "Tell what this machine offers, and what to do about what is missing.",
      "xauto doctor",
      [platform_out](const Options& options) { return doctor(*platform_out, options); });
  verb.option("--platform-out", *platform_out,
              "write a platform.json with this machine's CPUs here; a GPU or DLA that it "
              "lacks is in it as an emulated one");
}

}  // namespace xauto::cli
