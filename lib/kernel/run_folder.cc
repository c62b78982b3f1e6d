// SPDX-License-Identifier: Apache-2.0
#include "kernel/run_folder.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <uapi/xauto/bpf.h>

#include "kernel/bpf_sys.h"

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

UniqueFd open_folder(const std::string& path) {
  return UniqueFd(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
}

bool good_name(const std::string& run) {
  return !run.empty() && run.size() <= 64 && std::all_of(run.begin(), run.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-';
  });
}

std::vector<std::string> folders() {
  std::vector<std::string> names;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(XAUTO_BPF_ROOT, error))
    if (entry.is_directory(error) && good_name(entry.path().filename().string()))
      names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

Status make_folder(const std::string& path) {
  if (mkdir(path.c_str(), 0700) == 0 || errno == EEXIST) return {};
  return fail(errno == EACCES || errno == EPERM ? ErrorCode::kPermission : ErrorCode::kIo,
              path + ": " + strerror(errno), {}, bpf_hint());
}

}  // namespace

UniqueFd live_in(const std::string& folder) {
  UniqueFd there = open_folder(folder);
  while (flock(there.get(), LOCK_EX) != 0 && errno == EINTR) {
  }
  return there;
}

bool somebody_lives_in(const std::string& folder) {
  const UniqueFd there = open_folder(folder);
  return there && flock(there.get(), LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
}

LockOfAllRuns::LockOfAllRuns() : root_(live_in(XAUTO_BPF_ROOT)) {}

Status RunFolder::check_name(const std::string& run) {
  if (good_name(run)) return {};
  return fail(ErrorCode::kInvalid, "is no name for a run", "'" + run + "'",
              "letters, digits and dashes; `xauto top --once` shows the runs");
}

std::string RunFolder::path_of(const std::string& run) {
  return std::string(XAUTO_BPF_ROOT) + "/" + run;
}

std::vector<std::string> RunFolder::alive() {
  std::vector<std::string> alive = folders();
  std::erase_if(alive, [](const std::string& run) { return !somebody_lives_in(path_of(run)); });
  return alive;
}

void RunFolder::remove(const std::string& run) {
  std::error_code error;
  if (good_name(run)) fs::remove_all(path_of(run), error);
}

Result<RunFolder> RunFolder::make(const std::string& run) {
  XAUTO_TRY(check_name(run));
  XAUTO_TRY(mount_bpffs());
  XAUTO_TRY(make_folder(XAUTO_BPF_ROOT));
  RunFolder folder;
  const LockOfAllRuns lock;
  for (const std::string& old : folders())
    if (!somebody_lives_in(path_of(old))) remove(old);
  XAUTO_TRY(make_folder(path_of(run)));
  folder.run_ = run;
  folder.life_ = live_in(path_of(run));
  return folder;
}

RunFolder& RunFolder::operator=(RunFolder&& other) noexcept {
  std::swap(run_, other.run_);
  std::swap(life_, other.life_);
  return *this;
}

RunFolder::~RunFolder() {
  if (life_) remove(run_);
}

}  // namespace xauto::kernel
