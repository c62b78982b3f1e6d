// SPDX-License-Identifier: Apache-2.0
#include "kernel/libbpf/session.h"

#include <algorithm>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string_view>

#include <sys/utsname.h>

#include "base/log.h"
#include "base/pi_mutex.h"

namespace xauto::kernel {
namespace {

constexpr std::size_t kLongest = 1u << 17;
constexpr unsigned kVerifierCounts = 4;  ///< the kernel's BPF_LOG_STATS
PiMutex g_mutex;
std::string g_said XAUTO_GUARDED_BY(g_mutex);

int keep(libbpf_print_level level, const char* format, va_list arguments) {
  std::string line(kLongest, '\0');  // a verifier's log is one message
  const int length = vsnprintf(line.data(), line.size(), format, arguments);
  line.resize(
      static_cast<std::size_t>(std::min<int>(std::max(length, 0), static_cast<int>(kLongest) - 1)));
  while (!line.empty() && line.back() == '\n') line.pop_back();
  if (level == LIBBPF_WARN) {
    // The first line that is neither the verifier's log nor "failed to load" says what was wrong.
    constexpr std::string_view kPrefix = "libbpf: ";
    const Guard lock(g_mutex);
    if (g_said.empty() && line.find('\n') == std::string::npos &&
        line.find("failed to load") == std::string::npos && line.size() < 200)
      g_said = line.rfind(kPrefix, 0) == 0 ? line.substr(kPrefix.size()) : line;
  }
  log::debug("{}", line);
  return length;
}

}  // namespace

LibbpfMessages::LibbpfMessages() {
  const Guard lock(g_mutex);
  g_said.clear();
  libbpf_set_print(keep);
}

LibbpfMessages::~LibbpfMessages() {
  libbpf_set_print(keep);
}

std::string LibbpfMessages::said() {
  const Guard lock(g_mutex);
  return g_said;
}

tl::unexpected<Error> libbpf_failed(const std::string& what, int error) {
  error = error < 0 ? -error : error;
  const std::string said = LibbpfMessages::said();
  const bool denied = error == EPERM || error == EACCES;
  return fail(denied ? ErrorCode::kPermission : ErrorCode::kUnavailable,
              what + ": " + strerror(error) + (said.empty() ? "" : " (" + said + ")"), {},
              denied ? bpf_hint() : "XAUTO_LOG=debug shows all that libbpf says");
}

VerifierLog::VerifierLog(bpf_object* object)
    : path_(secure_getenv("XAUTO_VERIFIER_LOG")), object_(object) {
  if (path_ == nullptr) return;
  bpf_program* program = nullptr;
  bpf_object__for_each_program(program, object)
      logs_.emplace_back(bpf_program__name(program), std::string(kLongest, '\0'));
  std::size_t at = 0;
  bpf_object__for_each_program(program, object) {
    std::string& log = logs_[at++].second;
    bpf_program__set_log_buf(program, log.data(), log.size());
    bpf_program__set_log_level(program, kVerifierCounts);
  }
}

void VerifierLog::write() const {
  if (path_ == nullptr) return;
  std::ofstream file(path_, std::ios::app);
  utsname machine{};
  uname(&machine);
  file << "# " << bpf_object__name(object_) << " on Linux " << machine.release
       << "; libbpf: " << (LibbpfMessages::said().empty() ? "no warning" : LibbpfMessages::said())
       << '\n';
  for (const auto& [name, log] : logs_) file << name << ":\n" << log.c_str();
  if (!file) log::warn("cannot write the verifier's log to '{}'", path_);
}

Status reuse(bpf_map* map, const RunMaps& maps) {
  const std::string name = bpf_map__name(map);
  const int fd = maps.fd(name);
  if (fd < 0) return fail(ErrorCode::kInternal, "the run has no map '" + name + "'");
  // Compared here, since libbpf would take over whatever size the map has.
  XAUTO_TRY(check_shape(fd, name, bpf_map__value_size(map), 1, bpf_map__key_size(map)));
  if (const int error = bpf_map__reuse_fd(map, fd); error != 0)
    return libbpf_failed("map '" + name + "'", error);
  return {};
}

}  // namespace xauto::kernel
