// SPDX-License-Identifier: Apache-2.0
// The files that a verb writes. All are looked at before its work begins, and written after its
// result went to stdout: what was measured is never lost to a full disk.
#pragma once

#include <set>
#include <string>
#include <string_view>

#include <xauto/result.h>

namespace xauto::cli {

/// Threads: one owner.
class Outputs {
 public:
  /// A reader of stdout that goes away must not cost the files.
  Outputs();
  /// Before the work: can it be written? `option` names it in errors; an empty path is none.
  [[nodiscard]] Status expect(const std::string& option, const std::string& path);
  /// After the result was printed. A failure is an error line, and goes into `status`.
  void write(const std::string& path, std::string_view text);
  /// Something that was to be written could not be made, or an app could not write it.
  void failed(const Error& error);

  [[nodiscard]] bool good() const { return good_; }
  /// `status` if all was written.
  [[nodiscard]] int status(int status) const;

 private:
  std::set<std::string> expected_;
  bool good_ = true;
};

/// `file` as a link from `page` has it.
[[nodiscard]] std::string link_from(const std::string& page, const std::string& file);

}  // namespace xauto::cli
