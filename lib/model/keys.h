// SPDX-License-Identifier: Apache-2.0
// The keys of a file against those of its format: a misspelt optional key is told, not passed over.
// So is a name that is nowhere declared.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

namespace xauto {

/// Keys that begin so are other tools': never looked at.
inline constexpr std::string_view kOthersKeys = "x-";

struct Keys {
  struct Unknown {
    std::string where;    ///< JSON pointer
    std::string nearest;  ///< the key of the format that was probably meant; empty: none is near
  };
  /// Those that the reader of this file asked for: "/xnodes/*/name". What stands inside a part that
  /// the file does not have is not among them.
  std::vector<std::string> known;
  std::vector<Unknown> unknown;  ///< in the order of the file's keys
  /// Clocks that sources name and "clocks" does not: where, and what became of it. A misspelt name
  /// would otherwise be a clock of its own, in silence.
  struct Undeclared {
    std::string where, said;
  };
  std::vector<Undeclared> undeclared;
};

/// "is no key of this format; did you mean ...?"
[[nodiscard]] std::string said_of(const Keys::Unknown& key);

/// What the `load_*` functions do about unknown keys, for the whole process.
enum class UnknownKeys { kWarn, kRefuse };
void set_unknown_keys(UnknownKeys what);

/// Warns of each unknown key and undeclared name, or refuses the file; `path` names it.
[[nodiscard]] Status judge(const Keys& keys, const std::string& path);

}  // namespace xauto
