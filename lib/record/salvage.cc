// SPDX-License-Identifier: Apache-2.0
#include "record/salvage.h"

#include <filesystem>

#include "record/storage.h"

namespace xauto::record {

void Salvaged::leave_out(const std::string& path, const std::string& what) {
  if (++faults <= kMaxTold) left_out.push_back(path + ": " + what);
}

Result<Salvaged> salvage(const std::string& path, const Take& take) {
  namespace fs = std::filesystem;
  XAUTO_ASSIGN(const Found found, find_files(path));
  Salvaged out;
  for (const std::string& file : found.files) {
    std::error_code error;
    const auto status = fs::status(file, error);
    if (!fs::exists(status)) return fail(ErrorCode::kNotFound, "there is no such recording", file);
    if (!fs::is_regular_file(status)) {
      out.leave_out(file, "is not a regular file");
      continue;
    }
    XAUTO_TRY(fs::path(file).extension() == ".db3" ? salvage_sqlite(file, take, out)
                                                   : salvage_mcap(file, take, out));
  }
  for (const std::string& name : found.named)
    if (std::error_code error; !fs::exists(fs::path(path) / name, error))
      out.leave_out(path, "metadata.yaml names " + shown(name) + ", which is not there");
  return out;
}

}  // namespace xauto::record
