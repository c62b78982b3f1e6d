// SPDX-License-Identifier: Apache-2.0
// Errors as values. XAuto does not throw; see docs/errors.md for what is an error and what is not.
#pragma once

#include <string>
#include <utility>

#include <tl/expected.hpp>

namespace xauto {

/// What kind of failure it is; decides the exit status of the tools.
enum class ErrorCode {
  kInvalid,      ///< input is malformed or contradicts itself: exit status 2
  kNotFound,     ///< a file, a name, a device node is not there: exit status 2
  kInfeasible,   ///< the question has a well-founded "no" for an answer: exit status 1
  kPermission,   ///< the kernel refused; `hint` says how to get the right
  kUnavailable,  ///< the peer process or the device is gone or not supported here
  kIo,           ///< a system call failed for another reason
  kTimeout,      ///< a stated time limit passed
  kInternal,     ///< our own bug
};

/// One failure, written for the person who has to act on it.
struct Error {
  ErrorCode code = ErrorCode::kInternal;  ///< the kind, for programs
  std::string what;                       ///< what was wrong, with the offending value
  std::string where;                      ///< file, field, XNode, XPU: the place; may be empty
  std::string hint;                       ///< what to do about it; may be empty

  /// "where: what" and, on a second line, "hint: ...".
  [[nodiscard]] std::string to_string() const {
    std::string text = where.empty() ? what : where + ": " + what;
    if (!hint.empty()) text += "\n  hint: " + hint;
    return text;
  }
};

/// A value or an Error. `[[nodiscard]]` comes with tl::expected.
template <class T>
using Result = tl::expected<T, Error>;
/// Done, or an Error.
using Status = Result<void>;

/// The Error to return: `return fail(ErrorCode::kNotFound, "no such file", path);`
[[nodiscard]] inline tl::unexpected<Error> fail(ErrorCode code, std::string what,
                                                std::string where = {}, std::string hint = {}) {
  return tl::unexpected<Error>(Error{code, std::move(what), std::move(where), std::move(hint)});
}

}  // namespace xauto

/// Return early with the error of `expr`, a Result or Status.
#define XAUTO_TRY(expr)                                                           \
  do {                                                                            \
    if (auto xauto_try_result = (expr); !xauto_try_result)                        \
      return tl::unexpected<::xauto::Error>(std::move(xauto_try_result).error()); \
  } while (false)

#define XAUTO_CONCAT_(a, b) a##b
#define XAUTO_CONCAT(a, b) XAUTO_CONCAT_(a, b)
/// `XAUTO_ASSIGN(auto x, expr)`: the value of `expr`, or return early with its error.
#define XAUTO_ASSIGN(decl, expr) XAUTO_ASSIGN_(XAUTO_CONCAT(xauto_result_, __LINE__), decl, expr)
#define XAUTO_ASSIGN_(tmp, decl, expr)                                     \
  auto tmp = (expr);                                                       \
  if (!tmp) return tl::unexpected<::xauto::Error>(std::move(tmp).error()); \
  decl = std::move(tmp).value()
