// SPDX-License-Identifier: Apache-2.0
// What a person has asked for in an app.json, which no profile can know: it stays where the file is written anew.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

/// app.json of `fresh`, whose graph and WCETs are a profile's, with what `old`, the text of an app.json of the same app,
/// asks for: rates, offsets, jitter, clocks and urgent releases of its sources; max_in_flight and optional of its
/// modules; deadlines, chains and their weights; transfers; pins, forbids and groups. `lines`: for people, what of it
/// differs from the profile, and what fits no more. Errors: `old` is no
/// app.json, or no app has both.
[[nodiscard]] Result<std::string> with_what_was_asked(AppSpec fresh, std::string_view old,
                                                      const std::string& origin,
                                                      std::vector<std::string>& lines);

}  // namespace xauto
