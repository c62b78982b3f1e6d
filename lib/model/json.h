// SPDX-License-Identifier: Apache-2.0
// Files <-> value types; the only JSON code of the library (tools print --json with it too).
// Readers refuse what they do not understand with file, JSON pointer and cause. Unknown keys are
// ignored by `parse_*`, which list them in `keys`, and told or refused by `load_*` (keys.h).
// Threads: pure apart from the file access.
#pragma once

#include <string>
#include <string_view>

#include <xauto/result.h>

#include "model/app.h"
#include "model/demand.h"
#include "model/emulation_script.h"
#include "model/keys.h"
#include "model/platform.h"
#include "model/policy.h"
#include "model/priority_plan.h"
#include "model/profile.h"
#include "model/tables.h"

namespace xauto {

inline constexpr std::size_t kMaxFileBytes = 256u << 20;
inline constexpr int kMaxJsonDepth = 64;
/// Version of app.json, policy.json and tables.json. Other formats that are read have 1.
inline constexpr std::int64_t kAppVersion = 3;

// `origin` names the text in error messages, usually the file's path.
[[nodiscard]] Result<AppSpec> parse_app(std::string_view text, std::string_view origin,
                                        Keys* keys = nullptr);
[[nodiscard]] Result<Platform> parse_platform(std::string_view text, std::string_view origin,
                                              Keys* keys = nullptr);
[[nodiscard]] Result<Profile> parse_profile(std::string_view text, std::string_view origin,
                                            Keys* keys = nullptr);
/// XNode and XPU names are resolved against `app` and `platform`; `validate(policy, ...)` has
/// passed.
[[nodiscard]] Result<Policy> parse_policy(std::string_view text, std::string_view origin,
                                          const AppSpec& app, const Platform& platform,
                                          Keys* keys = nullptr);

/// See load_key_hint.
[[nodiscard]] Result<Policy> parse_key_hint(std::string_view text, std::string_view origin,
                                            const AppSpec& app, const Platform& platform);

[[nodiscard]] Result<Scenarios> parse_scenarios(std::string_view text, std::string_view origin,
                                                const AppSpec& app, const Platform& platform,
                                                Keys* keys = nullptr);
[[nodiscard]] Result<Tables> parse_tables(std::string_view text, std::string_view origin,
                                          const AppSpec& app, const Platform& platform,
                                          Keys* keys = nullptr);
[[nodiscard]] Result<Demand> parse_demand(std::string_view text, std::string_view origin,
                                          Keys* keys = nullptr);
[[nodiscard]] Result<EmulationScript> parse_emulation_script(std::string_view text,
                                                             std::string_view origin,
                                                             const Platform& platform,
                                                             Keys* keys = nullptr);

[[nodiscard]] std::string to_json(const AppSpec& app);
[[nodiscard]] std::string to_json(const Platform& platform);
[[nodiscard]] std::string to_json(const Profile& profile);
[[nodiscard]] std::string to_json(const Policy& policy, const AppSpec& app,
                                  const Platform& platform);
[[nodiscard]] std::string to_json(const Scenarios& scenarios);
[[nodiscard]] std::string to_json(const EmulationScript& script);
[[nodiscard]] std::string to_json(const Demand& demand);
[[nodiscard]] std::string to_json(const Tables& tables, const AppSpec& app,
                                  const Platform& platform);

[[nodiscard]] Result<AppSpec> load_app(const std::string& path);
/// `name_or_path`: a built-in name ("small", "large", "core-ultra") or a platform.json.
[[nodiscard]] Result<Platform> load_platform(const std::string& name_or_path);
/// ... and where that is empty the one that a policy.json or tables.json names, if it comes with XAuto; `small` where it
/// names none. kInvalid: it names another one, whose file is needed.
[[nodiscard]] Result<Platform> load_platform_of(const std::string& policy_path,
                                                const std::string& name_or_path);
[[nodiscard]] Result<Profile> load_profile(const std::string& path);
/// A policy of an earlier version of the app, or for an earlier platform, to begin with: what can be
/// said of the XNodes that are still there. One that was not, or was on an XPU that is gone, has
/// xpu -1 and no keys. No claim is read, nothing else is validated.
[[nodiscard]] Result<Policy> load_key_hint(const std::string& path, const AppSpec& app,
                                           const Platform& platform);
[[nodiscard]] Result<Policy> load_policy(const std::string& path, const AppSpec& app,
                                         const Platform& platform);

/// Also refused: its XPUs are not those of the platform.
[[nodiscard]] Result<Demand> load_demand(const std::string& path, const Platform& platform);
[[nodiscard]] Result<Scenarios> load_scenarios(const std::string& path, const AppSpec& app,
                                               const Platform& platform);
[[nodiscard]] Result<Tables> load_tables(const std::string& path, const AppSpec& app,
                                         const Platform& platform);
/// Whether a text, or a file, says that it is tables; what is none of ours is refused by who reads it.
[[nodiscard]] bool says_tables(std::string_view text);
[[nodiscard]] bool is_tables_file(const std::string& path);
[[nodiscard]] Result<EmulationScript> load_emulation_script(const std::string& path,
                                                            const Platform& platform);

/// Regular file, at most kMaxFileBytes.
[[nodiscard]] Result<std::string> read_file(const std::string& path);
/// The same of one that is open; `path` is for messages.
[[nodiscard]] Result<std::string> read_open_file(int fd, const std::string& path,
                                                 std::size_t max_bytes);
/// Whether `write_file` could make this file now. Leaves nothing behind, and what is there alone.
[[nodiscard]] Status check_writable(const std::string& path);
/// Writes beside the target and renames, so that a reader never sees half a file and what was there
/// stays until all is written. A device or a pipe is written into.
[[nodiscard]] Status write_file(const std::string& path, std::string_view text);

}  // namespace xauto
