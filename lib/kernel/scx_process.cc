// SPDX-License-Identifier: Apache-2.0
#include "kernel/scx_process.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/socket.h"

namespace xauto::kernel {
namespace {

/// The verifier takes its time on a slow machine: 12 s of an emulated guest's on 6.12; and for each CPU that comes or
/// goes meanwhile, the scheduler is loaded again.
constexpr int kReadyLimitMs = 60'000;
constexpr int kGraceMs = 2'000;

/// All that comes until the other end closes.
Result<std::string> read_answer(int fd) {
  std::string text;
  const std::int64_t limit = now_ns() + std::int64_t{kReadyLimitMs} * 1'000'000;
  for (;;) {
    const auto left = static_cast<int>((limit - now_ns()) / 1'000'000);
    if (left <= 0 || !wait_readable(fd, left))
      return fail(ErrorCode::kTimeout,
                  "did not answer within " + std::to_string(kReadyLimitMs / 1000) + " s");
    char buffer[512];
    const ssize_t size = read(fd, buffer, sizeof buffer);
    if (size < 0 && errno == EINTR) continue;
    if (size <= 0) return text;
    text.append(buffer, static_cast<std::size_t>(size));
    if (text.size() > 4096) return text;
  }
}

}  // namespace

Result<ScxProcess> start_scx(const std::string& bin, const std::string& run,
                             const std::vector<int>& cpus,
                             const std::vector<std::string>& arguments) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0)
    return fail(ErrorCode::kIo, std::string("pipe: ") + strerror(errno));
  const UniqueFd read_end(ends[0]);
  UniqueFd write_end(ends[1]);
  std::string list;
  for (const int cpu : cpus) list += (list.empty() ? "" : ",") + std::to_string(cpu);
  SpawnOptions options;
  options.argv = {bin + "/xauto-cpusched", "--run", run, "--ready-fd",
                  std::to_string(write_end.get())};
  if (!list.empty()) options.argv.insert(options.argv.end(), {"--cpus", list});
  options.argv.insert(options.argv.end(), arguments.begin(), arguments.end());
  options.inherit = {write_end.get()};
  ScxProcess process;
  XAUTO_ASSIGN(process.child, Child::spawn(options));
  write_end.reset();
  XAUTO_ASSIGN(const std::string answer, read_answer(read_end.get()));
  const std::size_t line = answer.find('\n');
  const std::string first = answer.substr(0, line);
  if (first.rfind("ok ", 0) == 0) {
    process.why = first.substr(3);
    return process;
  }
  const auto exit = process.child.wait(kGraceMs);
  if (first.rfind("no ", 0) == 0)
    return fail(ErrorCode::kUnavailable, first.substr(3), {},
                line == std::string::npos ? "" : answer.substr(line + 1));
  return fail(ErrorCode::kUnavailable, "xauto-cpusched ended without an answer" +
                                           (exit ? " (" + exit->to_string() + ")" : std::string()));
}

}  // namespace xauto::kernel
