// SPDX-License-Identifier: Apache-2.0
#include "model/keys.h"

#include <atomic>
#include <cstddef>

#include "base/log.h"

namespace xauto {
namespace {

constexpr std::size_t kMostTold = 20;
std::atomic<UnknownKeys> what_to_do{UnknownKeys::kWarn};

}  // namespace

std::string said_of(const Keys::Unknown& key) {
  return key.nearest.empty() ? "is no key of this format"
                             : "is no key of this format; did you mean \"" + key.nearest + "\"?";
}

void set_unknown_keys(UnknownKeys what) {
  what_to_do = what;
}

Status judge(const Keys& keys, const std::string& path) {
  const bool refuses = what_to_do == UnknownKeys::kRefuse;
  if (refuses && !keys.undeclared.empty())
    return fail(ErrorCode::kInvalid, keys.undeclared.front().said,
                path + ": " + keys.undeclared.front().where,
                "list it there; without --strict it is taken as it is");
  for (std::size_t i = 0; i < keys.undeclared.size() && i < kMostTold; ++i)
    log::warn("{}: {}: {}", path, keys.undeclared[i].where, keys.undeclared[i].said);
  if (keys.unknown.empty()) return {};
  if (refuses)
    return fail(ErrorCode::kInvalid, said_of(keys.unknown.front()),
                path + ": " + keys.unknown.front().where,
                "without --strict it is ignored; keys of other tools begin with \"" +
                    std::string(kOthersKeys) + "\"");
  for (std::size_t i = 0; i < keys.unknown.size() && i < kMostTold; ++i)
    log::warn("{}: {}: {} (ignored)", path, keys.unknown[i].where, said_of(keys.unknown[i]));
  if (keys.unknown.size() > kMostTold)
    log::warn("{}: {} more keys are not of this format", path, keys.unknown.size() - kMostTold);
  return {};
}

}  // namespace xauto
