// SPDX-License-Identifier: Apache-2.0
// The arrows of docs/architecture.md, compared with the #include lines: who may include whom.
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace {

namespace fs = std::filesystem;
using Names = std::set<std::string>;

/// Part of the tree -> parts it may include besides itself. "xauto" is include/xauto (public),
/// "uapi" is include/uapi. Every part under lib/ may also include "base" and "xauto".
const std::map<std::string, Names>& allowed() {
  static const std::map<std::string, Names> table = {
      {"lib/base", {}},
      {"lib/model", {}},
      {"lib/trace", {"uapi"}},
      {"lib/record", {}},
      {"lib/emu", {"model", "uapi"}},
      {"lib/coord", {"model", "trace", "uapi"}},
      {"lib/transport", {"model"}},
      {"lib/kernel", {"uapi"}},
      {"lib/xpu", {"model", "emu", "kernel"}},
      {"lib/session", {"model"}},
      {"lib/graph", {"model"}},
      {"lib/processes", {"model", "session", "graph", "transport"}},
      {"lib/profile", {"model", "record", "xpu", "session", "graph", "processes"}},
      {"lib/grid", {"model", "trace", "session", "graph", "processes"}},
      {"lib/parts", {"model", "transport", "session", "graph", "processes", "grid"}},
      {"lib/runtime",
       {"model", "trace", "coord", "transport", "xpu", "session", "graph", "processes", "grid",
        "parts", "uapi"}},
      {"lib/account", {"model", "session", "graph", "processes", "grid", "uapi"}},
      {"lib/tables", {"model", "trace", "session", "processes", "grid", "account", "uapi"}},
      {"lib/releases",
       {"model", "record", "session", "graph", "processes", "grid", "parts", "runtime", "account",
        "tables", "uapi"}},
      {"lib/engine",
       {"model", "trace", "transport", "session", "graph", "processes", "grid", "parts", "runtime",
        "account", "releases", "uapi"}},
      {"lib/launch",
       {"model", "trace", "emu", "coord", "kernel", "xpu", "session", "processes", "transport",
        "uapi"}},
      {"lib/app", {"model", "emu", "xpu", "session", "graph", "profile", "engine", "launch"}},
      {"lib/story", {"model", "trace", "uapi"}},
      {"lib/import", {"model", "record"}},
      {"solver", {"model"}},
      {"include/xauto", {}},
      {"include/uapi", {}},
      {"examples", {}},
  };
  return table;
}

const Names kParts = {"base",   "model",     "trace",   "record", "emu",     "coord",  "session",
                      "graph",  "processes", "profile", "grid",   "runtime", "parts",  "account",
                      "tables", "releases",  "engine",  "launch", "xpu",     "import", "transport",
                      "kernel", "app",       "solver",  "story",  "xauto",   "uapi",   "tools",
                      "bench",  "examples",  "tests",   "lib",    "kmod",    "bpf",    "include"};

/// Foreign headers that take seconds to compile -> files that may include them.
const std::map<std::string, Names>& expensive() {
  static const std::map<std::string, Names> table = {
      {"<CLI/", {"tools/cli/cli.cc"}},
      {"<nlohmann/",
       {"lib/model/deployment.cc", "lib/model/json_document.h", "lib/model/json_value.cc",
        "tests/unit/model/keys_test.cc"}},
  };
  return table;
}

/// What a text includes, with its first quotation mark.
std::vector<std::string> includes(std::istream& text) {
  std::vector<std::string> targets;
  std::string line;
  while (std::getline(text, line)) {
    std::istringstream words(line);
    std::string directive, target;
    words >> directive >> target;
    if (directive == "#" && target == "include")
      words >> target;
    else if (directive != "#include")
      continue;
    targets.push_back(target);
  }
  return targets;
}

/// First folders of what a text includes, of those that are ours.
std::vector<std::string> included_parts(std::istream& text) {
  std::vector<std::string> parts;
  for (const std::string& target : includes(text)) {
    const std::size_t slash = target.find('/');
    if (slash == std::string::npos || slash < 2) continue;
    if (target.starts_with("<bpf/")) continue;  // libbpf's; nobody includes our bpf/
    const std::string part = target.substr(1, slash - 1);
    if (part == "bpf" && target.front() == '<') continue;  // libbpf's headers, not our programs
    if (kParts.contains(part)) parts.push_back(part);
  }
  return parts;
}

bool may_include(const std::string& from, const std::string& to) {
  if (from.substr(from.rfind('/') + 1) == to) return true;
  if (to == "xauto") return from != "include/uapi";
  if (to == "base" && (from.starts_with("lib/") || from == "solver")) return true;
  return allowed().at(from).contains(to);
}

std::vector<fs::path> sources(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const fs::path extension = entry.path().extension();
    if (extension == ".cc" || extension == ".h" || extension == ".c") files.push_back(entry.path());
  }
  return files;
}

TEST(Layering, EveryIncludeFollowsAnArrowOfTheArchitecture) {
  const fs::path root = XAUTO_SOURCE_DIR;
  int read = 0;
  for (const auto& [part, may] : allowed()) {
    if (!fs::exists(root / part)) continue;
    for (const fs::path& file : sources(root / part)) {
      ++read;
      std::ifstream text(file);
      for (const std::string& to : included_parts(text))
        EXPECT_TRUE(may_include(part, to))
            << fs::relative(file, root).string() << " includes " << to << "/";
    }
  }
  EXPECT_GT(read, 40) << "the tree was not found";
}

TEST(Layering, EveryFolderOfLibHasItsArrows) {
  for (const auto& entry : fs::directory_iterator(fs::path(XAUTO_SOURCE_DIR) / "lib"))
    if (entry.is_directory()) {
      EXPECT_TRUE(allowed().contains("lib/" + entry.path().filename().string()))
          << entry.path() << ": add it to the table, and to docs/architecture.md";
    }
}

TEST(Layering, ExpensiveHeadersAreSeenByFewFiles) {
  const fs::path root = XAUTO_SOURCE_DIR;
  std::map<std::string, Names> seen;
  for (const char* part : {"lib", "solver", "tools", "bench", "examples", "include", "tests"})
    for (const fs::path& file : sources(root / part)) {
      std::ifstream text(file);
      for (const std::string& target : includes(text))
        for (const auto& [header, may] : expensive())
          if (target.starts_with(header)) seen[header].insert(fs::relative(file, root).string());
    }
  EXPECT_EQ(seen, expensive());
}

// The checker itself: an arrow turned round is seen.
TEST(Layering, ArrowTurnedRoundIsSeen) {
  std::istringstream text(
      "#include <vector>\n#include \"solver/solve.h\"\n  #include <xauto/app.h>\n#include "
      "\"x.h\"\n");
  EXPECT_EQ(included_parts(text), (std::vector<std::string>{"solver", "xauto"}));
  EXPECT_FALSE(may_include("lib/runtime", "solver"));
  EXPECT_FALSE(may_include("solver", "runtime"));
  EXPECT_FALSE(may_include("lib/model", "trace"));
  EXPECT_FALSE(may_include("examples", "model"));
  EXPECT_FALSE(may_include("include/xauto", "base"));
  EXPECT_FALSE(may_include("lib/runtime", "launch"));
  EXPECT_FALSE(may_include("lib/runtime", "profile"));
  EXPECT_FALSE(may_include("lib/profile", "runtime"));
  EXPECT_FALSE(may_include("lib/coord", "launch"));
  EXPECT_FALSE(may_include("lib/processes", "runtime"));
  EXPECT_TRUE(may_include("lib/runtime", "coord"));
  EXPECT_FALSE(may_include("lib/runtime", "account"));
  EXPECT_FALSE(may_include("lib/account", "runtime"));
  EXPECT_FALSE(may_include("lib/tables", "releases"));
  EXPECT_FALSE(may_include("lib/story", "runtime"));
  EXPECT_FALSE(may_include("lib/story", "solver"));
  EXPECT_FALSE(may_include("lib/story", "tools"));
}

}  // namespace
