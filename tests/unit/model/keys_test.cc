// SPDX-License-Identifier: Apache-2.0
// Misspelt keys, and that docs/schema/ has the keys that the readers ask for: neither more nor
// fewer. tests/docs/schema_test.py validates files against the schemas.
#include "model/keys.h"

#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <set>
#include <sstream>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "model/deployment.h"
#include "model/json.h"

#include "app_text.h"

namespace xauto {
namespace {

using test::app_text;

using nlohmann::json;
const std::string kSource = XAUTO_SOURCE_DIR;

std::string slurp(const std::string& path) {
  std::ifstream file(path);
  EXPECT_TRUE(file) << path;
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

/// "/xnodes/*/name" of every key that a schema describes. Maps are "*", as arrays are.
void describe(const json& root, const json& schema, const std::string& path,
              std::set<std::string>& keys) {
  if (schema.contains("$ref")) {
    const auto target = schema["$ref"].get<std::string>();
    return describe(root, root.at(json::json_pointer(target.substr(1))), path, keys);
  }
  for (const json& one : schema.value("anyOf", json::array())) describe(root, one, path, keys);
  const json properties = schema.value("properties", json::object());
  for (auto key = properties.begin(); key != properties.end(); ++key) {
    keys.insert(path + "/" + key.key());
    describe(root, key.value(), path + "/" + key.key(), keys);
  }
  for (const char* each : {"items", "additionalProperties"})
    if (schema.contains(each) && schema[each].is_object())
      describe(root, schema[each], path + "/*", keys);
}

/// "tables" of "tables-keys": golden files of one format begin with its name.
std::string format_of(const std::string& golden) {
  return golden.substr(0, golden.find('-'));
}

/// Reads a text of the kind of a golden file.
Status read(const std::string& kind, const std::string& text, Keys* keys) {
  const auto golden = [](const char* name) { return slurp(kSource + "/tests/golden/" + name); };
  static const AppSpec app = parse_app(golden("app.json"), "app.json").value(),
                       rates = parse_app(golden("app-rates.json"), "app-rates.json").value();
  static const Platform platform = parse_platform(golden("platform.json"), "platform.json").value();
  const auto status = [](auto result) {
    return result ? Status() : Status(tl::unexpected<Error>(std::move(result).error()));
  };
  const std::string format = format_of(kind);
  const AppSpec& of = kind.ends_with("-keys") ? rates : app;
  if (format == "app") return status(parse_app(text, format, keys));
  if (format == "platform") return status(parse_platform(text, format, keys));
  if (format == "profile") return status(parse_profile(text, format, keys));
  if (format == "policy") return status(parse_policy(text, format, of, platform, keys));
  if (format == "scenarios") return status(parse_scenarios(text, format, app, platform, keys));
  if (format == "demand") return status(parse_demand(text, format, keys));
  if (format == "emulation") return status(parse_emulation_script(text, format, platform, keys));
  if (format == "tables") return status(parse_tables(text, format, of, platform, keys));
  return status(parse_deployment(text, format, app, keys));
}

Keys keys_of(const std::string& format, const std::string& text) {
  Keys keys;
  const Status status = read(format, text, &keys);
  EXPECT_TRUE(status) << format << ": " << status.error().to_string();
  return keys;
}

/// What the golden file leaves out; not every format has one.
std::string with_other_keys(const std::string& format) {
  const std::string path = kSource + "/tests/golden/keys/" + format + ".json";
  return std::filesystem::exists(path) ? slurp(path) : std::string();
}

std::string golden(const std::string& format) {
  return slurp(kSource + "/tests/golden/" + format + ".json");
}

const char* const kGolden[] = {"app",    "app-rates",   "platform",  "profile",
                               "policy", "policy-keys", "scenarios", "deployment",
                               "tables", "tables-keys", "emulation", "demand"};

TEST(Keys, SchemasHaveTheKeysThatTheReadersAskFor) {
  std::map<std::string, std::set<std::string>> known;  // by format
  for (const std::string kind : kGolden)
    for (const std::string& text : {golden(kind), with_other_keys(kind)}) {
      if (text.empty()) continue;
      const Keys keys = keys_of(kind, text);
      known[format_of(kind)].insert(keys.known.begin(), keys.known.end());
      EXPECT_TRUE(keys.unknown.empty()) << kind << ": " << keys.unknown.front().where;
    }
  for (const auto& [format, keys] : known) {
    const json schema = json::parse(slurp(kSource + "/docs/schema/" + format + ".schema.json"));
    std::set<std::string> described;
    describe(schema, schema, "", described);
    EXPECT_EQ(described, keys) << format;
  }
}

/// Every key of every golden file, one after the other, with its last letter left out or its last
/// two exchanged: the reader either refuses the file, because the key is required, or says what was
/// meant. Nothing passes in silence.
TEST(Keys, NoMisspeltKeyPassesInSilence) {
  int told = 0, refused = 0;
  const std::function<void(const std::string&, const json&, json&, json&)> spoil =
      [&](const std::string& format, const json& schema, json& whole, json& at) {
        if (at.is_array())
          for (json& element : at) spoil(format, schema, whole, element);
        if (!at.is_object()) return;
        std::vector<std::string> names;
        for (auto member = at.begin(); member != at.end(); ++member) names.push_back(member.key());
        for (const std::string& name : names) {
          std::set<std::string> ours;
          describe(schema, schema, "", ours);
          const bool key_of_ours = std::any_of(
              ours.begin(), ours.end(),
              [&](const std::string& path) { return path.substr(path.rfind('/') + 1) == name; });
          if (key_of_ours && name.size() > 3) {
            std::string short_by_one = name.substr(0, name.size() - 1), swapped = name;
            std::swap(swapped[swapped.size() - 1], swapped[swapped.size() - 2]);
            for (const std::string& typo : {short_by_one, swapped}) {
              if (typo == name) continue;
              const json before = at;
              at[typo] = at[name];
              at.erase(name);
              Keys keys;
              const std::string text = whole.dump();
              const bool accepted = read(format, text, &keys).has_value();
              if (!accepted) {
                ++refused;
              } else {
                ++told;
                EXPECT_EQ(keys.unknown.size(), 1u) << format << " " << typo;
                for (const Keys::Unknown& key : keys.unknown) {
                  EXPECT_TRUE(key.where.ends_with("/" + typo)) << key.where;
                  EXPECT_EQ(key.nearest, name) << format;
                }
              }
              at = before;
            }
          }
          spoil(format, schema, whole, at[name]);
        }
      };
  for (const std::string kind : kGolden) {
    json document = json::parse(golden(kind));
    const json schema =
        json::parse(slurp(kSource + "/docs/schema/" + format_of(kind) + ".schema.json"));
    spoil(kind, schema, document, document);
  }
  EXPECT_GE(told, 40);
  EXPECT_GE(refused, 80);
}

TEST(Keys, TyposOfTheIssueAreNamedWithWhatWasMeant) {
  Keys keys;
  ASSERT_TRUE(parse_app(
      app_text(
          R"(,"deadine_us":5,"pinz":[],"chains":[{"name":"c","from":"s","to":"x","weigh":1}])"),
      "a.json", &keys));
  ASSERT_EQ(keys.unknown.size(), 3u);
  EXPECT_EQ(keys.unknown[0].where, "/chains/0/weigh");
  EXPECT_EQ(keys.unknown[0].nearest, "weight");
  EXPECT_EQ(keys.unknown[1].nearest, "deadline_us");
  EXPECT_EQ(keys.unknown[2].nearest, "pins");
  const AppSpec app = parse_app(app_text(""), "a.json").value();
  ASSERT_TRUE(parse_deployment(R"({"schema":"xauto.deployment","version":1,"app":"a",)"
                               R"("defaults":{"isolat":true},"modules":{"M":{"buget_pct":5}}})",
                               "d.json", app, &keys));
  ASSERT_EQ(keys.unknown.size(), 2u);
  EXPECT_EQ(keys.unknown[0].where, "/defaults/isolat");
  EXPECT_EQ(keys.unknown[0].nearest, "isolate");
  EXPECT_EQ(keys.unknown[1].where, "/modules/M/buget_pct");
  EXPECT_EQ(keys.unknown[1].nearest, "budget_pct");
}

TEST(Keys, KeysOfOthersAndWhatIsInThemAreNeverTold) {
  Keys keys;
  ASSERT_TRUE(
      parse_app(app_text(R"(,"x-":1,"x-deadine_us":{"pinz":[{"a":1}]},"colour":{"pinz":0})"),
                "a.json", &keys));
  ASSERT_EQ(keys.unknown.size(), 1u);
  EXPECT_EQ(keys.unknown[0].where, "/colour");
  EXPECT_EQ(keys.unknown[0].nearest, "");
}

TEST(Keys, NamesThatTheFileChoosesAreNoKeys) {
  Keys keys;
  ASSERT_TRUE(parse_platform(R"({"schema":"xauto.platform","version":1,"name":"p",)"
                             R"("xpus":[{"id":"c","type":"cpu"}]})",
                             "p.json", &keys));
  EXPECT_TRUE(keys.unknown.empty());
  std::string text = app_text("");
  const std::string wcet = R"("cpu":1)";
  text.replace(text.find(wcet), wcet.size(), R"("cpu":1,"name":2,"anything":3)");
  ASSERT_TRUE(parse_app(text, "a.json", &keys));
  EXPECT_TRUE(keys.unknown.empty()) << keys.unknown.front().where;
}

TEST(Keys, AClockThatIsNowhereDeclaredIsTold) {
  const std::string text = golden("app-rates");
  Keys keys = keys_of("app-rates", text);
  EXPECT_TRUE(keys.undeclared.empty()) << keys.undeclared.front().where;
  json document = json::parse(text);
  std::size_t with_clock = 0;
  for (json& source : document["sources"]) {
    if (!source.contains("clock") || source["clock"] == "main") {
      ++with_clock;
      continue;
    }
    source["clock"] = "lidra";
    break;
  }
  keys = keys_of("app-rates", document.dump());
  ASSERT_EQ(keys.undeclared.size(), 1u);
  EXPECT_EQ(keys.undeclared[0].where, "/sources/" + std::to_string(with_clock) + "/clock");
  EXPECT_NE(keys.undeclared[0].said.find("clock 'lidra' is not in \"clocks\" (known: main, lidar"),
            std::string::npos)
      << keys.undeclared[0].said;
  EXPECT_TRUE(judge(keys, "a.json"));
  set_unknown_keys(UnknownKeys::kRefuse);
  const Status refused = judge(keys, "a.json");
  set_unknown_keys(UnknownKeys::kWarn);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().where, "a.json: " + keys.undeclared[0].where);
}

TEST(Keys, StrictRefusesTheFileAndOtherwiseItIsRead) {
  const auto path = (std::filesystem::temp_directory_path() /
                     ("xauto_keys_test." + std::to_string(getpid()) + ".json"))
                        .string();
  ASSERT_TRUE(write_file(path, app_text(R"(,"deadine_us":5)")));
  EXPECT_TRUE(load_app(path));
  set_unknown_keys(UnknownKeys::kRefuse);
  const auto refused = load_app(path);
  set_unknown_keys(UnknownKeys::kWarn);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  EXPECT_EQ(refused.error().where, path + ": /deadine_us");
  EXPECT_NE(refused.error().what.find("did you mean \"deadline_us\"?"), std::string::npos);
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace xauto
