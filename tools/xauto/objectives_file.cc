// SPDX-License-Identifier: Apache-2.0
// See objectives_file.h.
#include "xauto/objectives_file.h"

#include "model/json.h"
#include "model/json_value.h"
#include "model/platform.h"

namespace xauto::cli {
namespace {

tl::unexpected<Error> bad(const std::string& path, const std::string& pointer,
                          const std::string& what) {
  return fail(ErrorCode::kInvalid, what, path + ": " + pointer);
}

Result<std::string> text(const Json& object, const char* key, const std::string& path,
                         const std::string& pointer) {
  const auto found = object.at(key).text();
  if (!found) return bad(path, pointer + "/" + key, "a string is expected here");
  return *found;
}

}  // namespace

Result<solver::Objectives> load_objectives(const std::string& app_path) {
  XAUTO_ASSIGN(const std::string file, read_file(app_path));
  return parse_objectives(file, app_path);
}

void add_wishes(Verb verb, Wishes& wishes) {
  verb.option("--pin", wishes.pins, "XNODE=XPU or XNODE=TYPE: only there");
  verb.option("--forbid", wishes.forbids, "XNODE=XPU or XNODE=TYPE: anywhere but there");
  verb.option("--group", wishes.groups, "XNODE,XNODE,...: on one instance");
}

Status add_to_objectives(const Wishes& wishes, solver::Objectives& objectives) {
  for (const std::string& pin : wishes.pins) {
    XAUTO_ASSIGN(auto parsed, parse_assignment(pin, "--pin"));
    objectives.pins.push_back(std::move(parsed));
  }
  for (const std::string& forbid : wishes.forbids) {
    XAUTO_ASSIGN(auto parsed, parse_assignment(forbid, "--forbid"));
    objectives.forbids.push_back(std::move(parsed));
  }
  for (const std::string& group : wishes.groups) {
    std::vector<std::string> names(1);
    for (const char c : group) {
      if (c == ',')
        names.emplace_back();
      else
        names.back() += c;
    }
    objectives.groups.push_back(std::move(names));
  }
  return {};
}

Result<solver::Objectives> parse_objectives(const std::string& file, const std::string& app_path) {
  solver::Objectives objectives;
  // load_app has parsed the same text before, so it is JSON and an object.
  const Json root = Json::parse(file).value_or(Json());
  const auto list = [&](const char* key) -> Result<std::vector<Json>> {
    if (root.has(key) && !root.at(key).is_array())
      return bad(app_path, std::string("/") + key, "an array is expected here");
    return root.at(key).elements();
  };
  for (const char* key : {"pins", "forbids"}) {
    XAUTO_ASSIGN(const std::vector<Json> entries, list(key));
    for (std::size_t k = 0; k < entries.size(); ++k) {
      const std::string pointer = std::string("/") + key + "/" + std::to_string(k);
      XAUTO_ASSIGN(std::string xnode, text(entries[k], "xnode", app_path, pointer));
      XAUTO_ASSIGN(std::string xpu, text(entries[k], "xpu", app_path, pointer));
      auto& target = std::string(key) == "pins" ? objectives.pins : objectives.forbids;
      target.emplace_back(std::move(xnode), std::move(xpu));
    }
  }
  XAUTO_ASSIGN(const std::vector<Json> groups, list("groups"));
  for (std::size_t k = 0; k < groups.size(); ++k) {
    const std::string pointer = "/groups/" + std::to_string(k);
    if (!groups[k].is_array()) return bad(app_path, pointer, "an array of names is expected here");
    std::vector<std::string> names;
    for (const Json& name : groups[k].elements()) {
      const auto found = name.text();
      if (!found) return bad(app_path, pointer, "an array of names is expected here");
      names.push_back(*found);
    }
    objectives.groups.push_back(std::move(names));
  }
  return objectives;
}

Result<std::pair<std::string, std::string>> parse_assignment(const std::string& given,
                                                             const std::string& option) {
  const std::size_t sign = given.rfind('=');
  if (sign == std::string::npos || sign == 0 || sign + 1 == given.size())
    return fail(ErrorCode::kInvalid, "'" + given + "' is not of the form XNODE=XPU", option);
  return std::pair(given.substr(0, sign), given.substr(sign + 1));
}

}  // namespace xauto::cli
