// SPDX-License-Identifier: Apache-2.0
#include "xauto/outputs.h"

#include <filesystem>
#include <iostream>
#include <system_error>

#include <signal.h>
#include <sys/stat.h>

#include "base/log.h"
#include "model/json.h"

#include "xauto/command.h"

namespace xauto::cli {

Outputs::Outputs() {
  signal(SIGPIPE, SIG_IGN);
}

Status Outputs::expect(const std::string& option, const std::string& path) {
  if (path.empty()) return {};
  struct stat status {};
  const bool device = stat(path.c_str(), &status) == 0 && !S_ISREG(status.st_mode);
  if (!device && !expected_.insert(path).second)
    return fail(ErrorCode::kInvalid, "is the file of another option, too", option + " " + path,
                "give each its own");
  Status writable = check_writable(path);
  if (!writable) writable.error().where = option + " " + path;
  return writable;
}

void Outputs::write(const std::string& path, std::string_view text) {
  if (path.empty()) return;
  std::cout.flush();
  if (const Status written = write_file(path, text); !written) failed(written.error());
}

void Outputs::failed(const Error& error) {
  log::error("{}", error.to_string());
  good_ = false;
}

int Outputs::status(int status) const {
  return status == kDone && !good_ ? kAnswerIsNo : status;
}

std::string link_from(const std::string& page, const std::string& file) {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::path folder = fs::absolute(page, error).parent_path();
  const fs::path path = fs::proximate(fs::absolute(file, error), folder, error);
  return error ? file : path.string();
}

}  // namespace xauto::cli
