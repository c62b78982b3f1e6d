// SPDX-License-Identifier: Apache-2.0
// Answers to what an imported app does not know.
#pragma once

#include <cstddef>
#include <string>

#include <xauto/result.h>

#include "model/imported.h"

namespace xauto::import {

/// `imported` with `answer`, a JSON value or else a text, at the place of its TODO number `todo`, which then is none any
/// more. What is an object there gets the answer's members beside its own; "/-" at the end of the place appends to an
/// array. Errors: the TODO has no place; no app has this there.
[[nodiscard]] Result<ImportedApp> with_answer(const ImportedApp& imported, std::size_t todo,
                                              const std::string& answer);

}  // namespace xauto::import
