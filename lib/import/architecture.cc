// SPDX-License-Identifier: Apache-2.0
#include "import/architecture.h"

#include <charconv>

#include "import/yaml.h"

namespace xauto::import {
namespace {

std::string said(const Yaml& value) {
  return value.text == "UNDEFINED" ? std::string() : value.text;
}

/// Its symbol is one text, whatever lines the file breaks it into.
ArchitectureCallback callback_of(const Yaml& callback, const std::string& node) {
  ArchitectureCallback one{said(callback["callback_name"]), node, said(callback["topic_name"]), 0,
                           callback["symbol"].text};
  const std::string& period = callback["period_ns"].text;
  std::from_chars(period.data(), period.data() + period.size(), one.period_ns);
  return one;
}

}  // namespace

Result<Architecture> parse_architecture(std::string_view text, const std::string& origin) {
  XAUTO_ASSIGN(const Yaml file, parse_yaml(text, origin));
  Architecture made;
  for (const Yaml& path : file["named_paths"].list) {
    ArchitecturePath one{path["path_name"].text, {}};
    for (const Yaml& step : path["node_chain"].list)
      one.steps.push_back({said(step["node_name"]), said(step["subscribe_topic_name"]),
                           said(step["publish_topic_name"])});
    made.paths.push_back(std::move(one));
  }
  for (const Yaml& node : file["nodes"].list) {
    const std::string name = said(node["node_name"]);
    for (const Yaml& callback : node["callbacks"].list)
      made.callbacks.push_back(callback_of(callback, name));
    for (const Yaml& passing : node["variable_passings"].list) {
      const std::string from = said(passing["callback_name_write"]),
                        to = said(passing["callback_name_read"]);
      if (!from.empty() && !to.empty()) made.passings.emplace_back(from, to);
    }
  }
  if (made.paths.empty() && made.callbacks.empty())
    return fail(ErrorCode::kInvalid, "is no architecture of CARET: neither named_paths nor nodes",
                origin, "`ros2 caret create_architecture_file` writes one");
  return made;
}

}  // namespace xauto::import
