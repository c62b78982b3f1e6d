// SPDX-License-Identifier: Apache-2.0
// emulation.json.
#include <cstdint>

#include "model/emulation_script.h"
#include "model/json.h"
#include "model/json_parts.h"

namespace xauto {

using namespace json_parts;

namespace {

using Percents = std::map<std::string, std::int64_t, std::less<>>;

Percents read_percents(const Reader& step, const char* key, std::int64_t low, std::int64_t high) {
  Percents percents;
  if (step.has(key))
    step[key].each_member(kMaxXpus, [&](const std::string& type, const Reader& pct) {
      percents[type] = pct.integer(low, high);
    });
  return percents;
}

std::vector<std::string> read_names(const Reader& step, const char* key) {
  std::vector<std::string> names;
  if (step.has(key))
    step[key].each_element(kMaxXpus,
                           [&](std::size_t, const Reader& id) { names.push_back(id.text()); });
  return names;
}

}  // namespace

Result<EmulationScript> parse_emulation_script(std::string_view text, std::string_view origin,
                                               const Platform& platform, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.emulation");
  EmulationScript script;
  root["steps"].each_element(kMaxEmulationSteps, [&](std::size_t, const Reader& x) {
    EmulationStep step;
    step.at_us = x["at_us"].time();
    step.speed_pct = read_percents(x, "speed_pct", 1, kMaxSpeedPct);
    step.contention_pct = read_percents(x, "contention_pct", 0, kMaxContentionPct);
    step.stop = read_names(x, "stop");
    step.start = read_names(x, "start");
    script.steps.push_back(std::move(step));
  });
  if (root.has("repeat_us")) script.repeat_us = root["repeat_us"].integer(kMinRepeatUs, kMaxTimeUs);
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(script, platform), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return script;
}

std::string to_json(const EmulationScript& script) {
  ordered_json document = {{"schema", "xauto.emulation"}, {"version", 1}};
  document["steps"] = ordered_json::array();
  for (const EmulationStep& s : script.steps) {
    ordered_json step = {{"at_us", s.at_us}};
    if (!s.speed_pct.empty()) step["speed_pct"] = s.speed_pct;
    if (!s.contention_pct.empty()) step["contention_pct"] = s.contention_pct;
    if (!s.stop.empty()) step["stop"] = s.stop;
    if (!s.start.empty()) step["start"] = s.start;
    document["steps"].push_back(std::move(step));
  }
  if (script.repeat_us > 0) document["repeat_us"] = script.repeat_us;
  return json_document::to_text(document);
}

Result<EmulationScript> load_emulation_script(const std::string& path, const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(EmulationScript script, parse_emulation_script(text, path, platform, &keys));
  XAUTO_TRY(judge(keys, path));
  return script;
}

}  // namespace xauto
