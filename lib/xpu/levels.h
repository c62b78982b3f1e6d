// SPDX-License-Identifier: Apache-2.0
// What xauto::levels() answers, in an `init`.
#pragma once

namespace xauto::xpu {

/// While it lives, on this thread.
class TellLevels {
 public:
  explicit TellLevels(int levels);
  ~TellLevels();
  TellLevels(const TellLevels&) = delete;
  TellLevels& operator=(const TellLevels&) = delete;
};

}  // namespace xauto::xpu
