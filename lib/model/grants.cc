// SPDX-License-Identifier: Apache-2.0
#include "model/grants.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "model/json.h"
#include "model/json_document.h"

namespace xauto {
namespace {

using json_document::Reader;
using nlohmann::ordered_json;

constexpr std::array<const char*, 3> kTo = {"user", "group", "cgroup"};
constexpr const char* kWhyOnly = "a misspelt key would change who may what";

const char* word(Grant::To to) {
  return kTo[static_cast<std::size_t>(to)];
}

/// "/a/b": absolute, no empty, "." or ".." part, no slash at the end; or "/", everybody.
bool is_cgroup_path(const std::string& path) {
  if (path == "/") return true;
  if (path.empty() || path.front() != '/') return false;
  for (std::size_t at = 0; at < path.size();) {
    const std::size_t end = std::min(path.find('/', at + 1), path.size());
    const std::string_view part = std::string_view(path).substr(at + 1, end - at - 1);
    if (part.empty() || part == "." || part == "..") return false;
    at = end;
  }
  return true;
}

Grant read_grant(const Reader& r) {
  r.allow_only({"user", "group", "cgroup", "lowest", "highest"}, kWhyOnly);
  Grant grant;
  int named = 0;
  for (std::size_t i = 0; i < kTo.size(); ++i)
    if (r.has(kTo[i])) {
      grant.to = static_cast<Grant::To>(i);
      grant.name = r[kTo[i]].text();
      ++named;
    }
  if (named != 1) r.refuse(R"(must name one of "user", "group", "cgroup")");
  const Reader name = r[word(grant.to)];
  if (grant.name.empty()) name.refuse("must not be empty");
  if (grant.to == Grant::To::kCgroup && !is_cgroup_path(grant.name))
    name.refuse("is no path of a cgroup", "as /proc/PID/cgroup has it: \"/system.slice/xauto\"");
  grant.range.highest = static_cast<int>(r["highest"].integer(1, kMaxGrantedFifo));
  grant.range.lowest =
      r.has("lowest") ? static_cast<int>(r["lowest"].integer(1, kMaxGrantedFifo)) : 1;
  if (grant.range.lowest > grant.range.highest) r["lowest"].refuse("is above \"highest\"");
  return grant;
}

bool is(const Identity::Id& id, const std::string& name) {
  return name == id.name || name == std::to_string(id.number);
}

bool matches(const Grant& grant, const Identity& who) {
  switch (grant.to) {
    case Grant::To::kUser:
      return is(who.user, grant.name);
    case Grant::To::kGroup:
      return std::any_of(who.groups.begin(), who.groups.end(),
                         [&](const Identity::Id& group) { return is(group, grant.name); });
    case Grant::To::kCgroup:
      if (who.cgroup.empty()) return false;
      return grant.name == "/" || who.cgroup == grant.name ||
             who.cgroup.starts_with(grant.name + "/");
  }
  return false;
}

Status check_owner(const struct stat& status, uid_t owner, const std::string& path) {
  const auto refuse = [&](const std::string& what, const std::string& hint) {
    return Status(fail(ErrorCode::kPermission, what, path, hint));
  };
  if (status.st_uid != owner)
    return refuse(
        "belongs to uid " + std::to_string(status.st_uid) + ", not to uid " + std::to_string(owner),
        "chown " + std::to_string(owner) + " " + path);
  if ((status.st_mode & (S_IWGRP | S_IWOTH)) != 0)
    return refuse("can be written by others than its owner", "chmod go-w " + path);
  return {};
}

}  // namespace

std::string Grant::to_string() const {
  return std::string(word(to)) + " " + name;
}

const Grant* Grants::find(const Identity& identity) const {
  const Grant* best = nullptr;
  for (const Grant& grant : grants) {
    if (!matches(grant, identity)) continue;
    if (best == nullptr || grant.range.highest > best->range.highest ||
        (grant.range.highest == best->range.highest && grant.range.lowest < best->range.lowest))
      best = &grant;
  }
  return best;
}

Result<Grants> parse_grants(std::string_view text, std::string_view origin, Keys* keys) {
  if (text.size() > kMaxGrantsBytes)
    return fail(ErrorCode::kInvalid, "is longer than " + std::to_string(kMaxGrantsBytes) + " bytes",
                std::string(origin));
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.grants");
  root.allow_only({"schema", "version", "grants"}, kWhyOnly);
  Grants grants;
  root["grants"].each_element(kMaxGrants, [&](std::size_t, const Reader& element) {
    grants.grants.push_back(read_grant(element));
  });
  XAUTO_TRY(context.status());
  if (keys != nullptr) *keys = context.keys(document);
  return grants;
}

std::string to_json(const Grants& grants) {
  ordered_json list = ordered_json::array();
  for (const Grant& grant : grants.grants)
    list.push_back({{word(grant.to), grant.name},
                    {"lowest", grant.range.lowest},
                    {"highest", grant.range.highest}});
  return json_document::to_text(
      {{"schema", "xauto.grants"}, {"version", 1}, {"grants", std::move(list)}});
}

Result<Grants> load_grants(const std::string& path, uid_t owner) {
  const std::size_t slash = path.rfind('/');
  const std::string folder = slash == std::string::npos ? "."
                             : slash == 0               ? "/"
                                                        : path.substr(0, slash);
  // The folder first: who can write it can put another file in place of this one.
  const UniqueFd parent(open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
  struct stat status {};
  if (!parent || fstat(parent.get(), &status) != 0)
    return fail(errno == ENOENT ? ErrorCode::kNotFound : ErrorCode::kPermission,
                std::string("cannot be opened: ") + strerror(errno), folder);
  XAUTO_TRY(check_owner(status, owner, folder));
  const UniqueFd file(openat(parent.get(),
                             path.c_str() + (slash == std::string::npos ? 0 : slash + 1),
                             O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
  if (!file || fstat(file.get(), &status) != 0)
    return fail(errno == ENOENT ? ErrorCode::kNotFound : ErrorCode::kPermission,
                std::string("cannot be opened: ") + strerror(errno), path);
  if (!S_ISREG(status.st_mode)) return fail(ErrorCode::kPermission, "is not a regular file", path);
  XAUTO_TRY(check_owner(status, owner, path));
  XAUTO_ASSIGN(const std::string text, read_open_file(file.get(), path, kMaxGrantsBytes));
  return parse_grants(text, path);
}

std::string cgroup_of(std::string_view proc_cgroup) {
  constexpr std::string_view kUnified = "0::";
  for (std::size_t at = 0; at < proc_cgroup.size();) {
    const std::size_t end = std::min(proc_cgroup.find('\n', at), proc_cgroup.size());
    const std::string_view line = proc_cgroup.substr(at, end - at);
    if (line.starts_with(kUnified)) return std::string(line.substr(kUnified.size()));
    at = end + 1;
  }
  return {};
}

}  // namespace xauto
