// SPDX-License-Identifier: Apache-2.0
// `xauto run --part HOST --meet ADDRESS:PORT`: one host's part of an app over several computers, and one report of all.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "launch/meeting.h"
#include "session/run_report.h"

#include "xauto/run_app.h"

namespace xauto::cli {

/// XPUs of `host` go first, so that a machine counts its own from 0. kInvalid: the platform has no such host.
[[nodiscard]] Status put_first(Platform& platform, const std::string& host);
/// [XPU] those of other hosts are absent. As `decide` of EmulationOptions for the others.
[[nodiscard]] Result<std::vector<Presence>> presence_of_part(const RunFlags& flags);
/// Errors: what a part of a run does not do.
[[nodiscard]] Status check_part(const RunFlags& flags, const PolicyRun& run);

/// Comes together with the other parts.
[[nodiscard]] Result<std::unique_ptr<launch::Meeting>> meet(const RunFlags& flags,
                                                            const PolicyRun& run,
                                                            const std::atomic<bool>* stop);
/// The part's report to the others; on the first host theirs to this one. `stopped`: nobody waits for the others' ends.
void join_reports(launch::Meeting& meeting, bool stopped, PolicyRun& run);

/// `one` is the report of another part, of `host`: adds it. What each has of its own is in one of them alone.
void add_report(const runtime::RunReport& one, const std::string& host, runtime::RunReport& into);

/// Of a policy of several hosts that one machine runs by one clock.
void note_one_machine(const RunFlags& flags, PolicyRun& run);

}  // namespace xauto::cli
