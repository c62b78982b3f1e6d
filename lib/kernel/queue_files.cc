// SPDX-License-Identifier: Apache-2.0
#include "kernel/queue_files.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <set>
#include <string_view>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <uapi/xauto/nvgpu.h>
#include <unistd.h>

#include "base/pi_mutex.h"
#include "base/syscalls.h"
#include "kernel/descriptor.h"
#include "kernel/device_nodes.h"
#include "kernel/i915_contexts.h"
#include "kernel/kfd_queues.h"
#include "kernel/pid_namespace.h"
#include "kernel/rm_queues.h"

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

bool ends_with_number(std::string_view text, std::string_view prefix, int& number) {
  if (!text.starts_with(prefix)) return false;
  text.remove_prefix(prefix.size());
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  return error == std::errc{} && end == text.data() + text.size() && !text.empty();
}

bool is_anonymous_tsg(std::string_view target) {
  if (!target.starts_with("anon_inode:nvgpu-")) return false;
  const std::size_t at = target.rfind("-tsg");
  int number = 0;
  return at != std::string_view::npos && ends_with_number(target.substr(at), "-tsg", number);
}

std::optional<std::size_t> count_by_node(int node, pid_t pid) {
  std::vector<std::uint64_t> ids(64);  // twice what any GPU of today has channels
  const auto ask = [&] {
    nvgpu_sched_get_tsgs_by_pid_args args{};
    args.pid = static_cast<__u64>(pid);
    args.size = static_cast<__u32>(ids.size() * sizeof ids[0]);
    args.buffer = reinterpret_cast<std::uintptr_t>(ids.data());
    return ioctl(node, NVGPU_SCHED_IOCTL_GET_TSGS_BY_PID, &args) == 0;
  };
  if (!ask()) return {};
  std::size_t count = 0;
  for (const std::uint64_t word : ids) count += static_cast<std::size_t>(std::popcount(word));
  return count;
}

/// Numbers of those that live.
struct Duplicates {
  PiMutex mutex;
  std::set<int> numbers XAUTO_GUARDED_BY(mutex);
};

Duplicates& duplicates() {
  static Duplicates duplicates;
  return duplicates;
}

}  // namespace

bool classify_queue_file(const std::string& target, QueueFile& file) {
  file.target = target;
  file.instance = -1;
  const bool tsg_node =
      target == kOldTsgNode || (target.starts_with(kNvgpuFolder) && target.ends_with("/tsg"));
  if (is_anonymous_tsg(target) || tsg_node) {
    file.type = QueueType::kGpuTsg;
    return true;
  }
  for (const char* prefix : kDlaPrefixes)
    if (ends_with_number(target, prefix, file.instance)) {
      file.type = QueueType::kDla;
      return true;
    }
  return false;
}

Result<std::vector<QueueFile>> find_queue_files(pid_t pid, const std::string& root) {
  const std::string folder = root + "/proc/" + std::to_string(pid) + "/fd";
  std::error_code error;
  std::vector<QueueFile> found;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;  // a descriptor may close while we look
    const std::string target = fs::read_symlink(it->path(), gone).string();
    QueueFile file;
    const std::string name = it->path().filename().string();
    if (gone || !classify_queue_file(target, file)) continue;
    if (std::from_chars(name.data(), name.data() + name.size(), file.fd).ec != std::errc{})
      continue;
    found.push_back(std::move(file));
  }
  if (error == std::errc::permission_denied)
    return fail(ErrorCode::kPermission, "its descriptors are not ours to look at", folder,
                "run as the user of that process or as root");
  if (error) return fail(ErrorCode::kNotFound, "no such process: " + error.message(), folder);
  std::sort(found.begin(), found.end(),
            [](const QueueFile& a, const QueueFile& b) { return a.fd < b.fd; });
  return found;
}

std::optional<std::size_t> count_tsgs(pid_t pid) {
  if (own_pid_namespace() != kFirstPidNamespace) return {};
  for (const char* path : kGpuSchedNodes)
    if (const UniqueFd node(open(path, O_RDWR | O_CLOEXEC | O_NONBLOCK)); node)
      return count_by_node(node.get(), pid);
  return {};
}

Result<std::vector<QueueFile>> find_own_queues() {
  const Guard lock(duplicates().mutex);  // none comes or goes while they are read
  XAUTO_ASSIGN(std::vector<QueueFile> all, find_queue_files(getpid()));
  std::erase_if(all, [](const QueueFile& file) XAUTO_REQUIRES(duplicates().mutex) {
    return duplicates().numbers.contains(file.fd);
  });
  for (const auto find : {find_rm_groups, find_kfd_queues, find_i915_contexts})
    for (QueueFile& file : find()) all.push_back(std::move(file));
  return all;
}

bool is_open(const QueueFile& file) {
  const auto is_among = [&](const std::vector<QueueFile>& all) {
    return std::find(all.begin(), all.end(), file) != all.end();
  };
  switch (file.type) {
    case QueueType::kRmGroup:
      return is_among(find_rm_groups());
    case QueueType::kKfdQueue:
      return is_among(find_kfd_queues());
    case QueueType::kI915Context:
      return is_among(find_i915_contexts());
    case QueueType::kGpuTsg:
    case QueueType::kDla:
      break;
  }
  return leads_to(file.fd, file.target);
}

Duplicate::Duplicate(int fd, const std::string& target) {
  const Guard lock(duplicates().mutex);
  fd_.reset(fcntl(fd, F_DUPFD_CLOEXEC, 0));
  if (fd_ && leads_to(fd_.get(), target))
    duplicates().numbers.insert(fd_.get());
  else
    fd_.reset();
}

Duplicate& Duplicate::operator=(Duplicate&& other) noexcept {
  close();
  fd_ = std::move(other.fd_);
  return *this;
}

void Duplicate::close() {
  if (!fd_) return;
  const Guard lock(duplicates().mutex);
  duplicates().numbers.erase(fd_.get());
  fd_.reset();
}

Result<UniqueFd> take_descriptor(pid_t pid, int fd) {
  const std::string where =
      "descriptor " + std::to_string(fd) + " of process " + std::to_string(pid);
  const UniqueFd process(static_cast<int>(syscall(SYS_pidfd_open, pid, 0)));
  if (!process) return fail(ErrorCode::kNotFound, std::strerror(errno), where);
  UniqueFd copy(static_cast<int>(syscall(SYS_pidfd_getfd, process.get(), fd, 0)));
  if (copy) return copy;
  if (errno == EPERM)
    return fail(ErrorCode::kPermission, "the kernel does not let this process trace that one",
                where,
                "run as the same user with kernel.yama.ptrace_scope=0, or with CAP_SYS_PTRACE");
  return fail(errno == EBADF ? ErrorCode::kNotFound : ErrorCode::kIo, std::strerror(errno), where);
}

}  // namespace xauto::kernel
