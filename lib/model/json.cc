// SPDX-License-Identifier: Apache-2.0
#include "model/json.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <unordered_map>

namespace xauto {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

// ---- text to json, guarded -------------------------------------------------------------------------

/// Builds the document while watching what nlohmann's own parser lets pass: depth and duplicate keys.
class Guard {
 public:
  bool operator()(int depth, json::parse_event_t event, json& parsed) {
    switch (event) {
      case json::parse_event_t::object_start:
        keys_.emplace_back();
        [[fallthrough]];
      case json::parse_event_t::array_start:
        if (depth > kMaxJsonDepth) throw std::runtime_error("nested deeper than " + std::to_string(kMaxJsonDepth));
        break;
      case json::parse_event_t::object_end:
        keys_.pop_back();
        break;
      case json::parse_event_t::key:
        if (!keys_.empty() && !keys_.back().insert(parsed.get<std::string>()).second)
          throw std::runtime_error("key " + parsed.dump() + " is there twice");
        break;
      default:
        break;
    }
    return true;
  }

 private:
  std::vector<std::set<std::string>> keys_;
};

Result<json> parse(std::string_view text, std::string_view origin) {
  if (text.size() > kMaxFileBytes)
    return fail(ErrorCode::kInvalid, "is longer than " + std::to_string(kMaxFileBytes) + " bytes",
                std::string(origin));
  try {
    Guard guard;
    return json::parse(text.begin(), text.end(), std::ref(guard));
  } catch (const json::parse_error& e) {
    // "[json.exception.parse_error.101] parse error at line 3, column 7: syntax error while ..."
    std::string what = e.what();
    if (const std::size_t start = what.find("at line"); start != std::string::npos)
      what = "is not JSON " + what.substr(start);
    else if (const std::size_t bracket = what.find("] "); bracket != std::string::npos)
      what = "is not JSON: " + what.substr(bracket + 2);
    return fail(ErrorCode::kInvalid, what, std::string(origin));
  } catch (const std::exception& e) {
    return fail(ErrorCode::kInvalid, e.what(), std::string(origin));
  }
}

// ---- a value and where it is -----------------------------------------------------------------------

std::string shorten(const json& value) {
  std::string text = value.dump(-1, ' ', true, json::error_handler_t::replace);
  if (text.size() > 60) text = text.substr(0, 57) + "...";
  return text;
}

/// Cursor into a document. The first error sticks; reads after it give neutral values, so that readers
/// need no check per key: they ask `status()` once at the end.
class Reader {
 public:
  struct Context {
    std::string origin;
    std::optional<Error> error;
  };

  Reader(Context& context, const json* value, std::string path)
      : context_(context), value_(value), path_(std::move(path)) {}

  [[nodiscard]] bool failed() const { return context_.error.has_value(); }
  void refuse(std::string what, std::string hint = {}) const {
    if (failed()) return;
    context_.error = Error{ErrorCode::kInvalid, std::move(what),
                           path_.empty() ? context_.origin : context_.origin + ": " + path_,
                           std::move(hint)};
  }

  [[nodiscard]] bool has(const char* key) const {
    return value_ != nullptr && value_->is_object() && value_->contains(key);
  }
  [[nodiscard]] Reader operator[](const char* key) const {
    if (value_ != nullptr && !value_->is_object())
      refuse("must be an object, is " + shorten(*value_));
    else if (value_ != nullptr && !value_->contains(key))
      refuse("key \"" + std::string(key) + "\" is missing");
    return {context_, failed() || value_ == nullptr ? nullptr : &(*value_)[key], path_ + "/" + key};
  }
  template <class Each>
  void each_element(std::size_t limit, Each each) const {
    if (value_ == nullptr) return;
    if (!value_->is_array()) return refuse("must be an array, is " + shorten(*value_));
    if (value_->size() > limit)
      return refuse("has " + std::to_string(value_->size()) + " elements, at most " +
                    std::to_string(limit) + " are possible");
    for (std::size_t i = 0; i < value_->size() && !failed(); ++i)
      each(i, Reader(context_, &(*value_)[i], path_ + "/" + std::to_string(i)));
  }
  template <class Each>
  void each_member(Each each) const {
    if (value_ == nullptr) return;
    if (!value_->is_object()) return refuse("must be an object, is " + shorten(*value_));
    for (const auto& [key, value] : value_->items()) {
      if (failed()) return;
      each(key, Reader(context_, &value, path_ + "/" + key));
    }
  }
  [[nodiscard]] std::string text() const {
    if (value_ == nullptr) return {};
    if (!value_->is_string()) {
      refuse("must be a string, is " + shorten(*value_));
      return {};
    }
    const auto& string = value_->get_ref<const std::string&>();
    if (string.size() > kMaxNameBytes) {
      refuse("is longer than " + std::to_string(kMaxNameBytes) + " bytes");
      return {};
    }
    return string;
  }
  [[nodiscard]] bool boolean() const {
    if (value_ == nullptr) return false;
    if (!value_->is_boolean()) {
      refuse("must be true or false, is " + shorten(*value_));
      return false;
    }
    return value_->get<bool>();
  }
  [[nodiscard]] std::int64_t integer(std::int64_t low, std::int64_t high) const {
    if (value_ == nullptr) return low;
    const bool fits = value_->is_number_unsigned()
                          ? value_->get<std::uint64_t>() <= static_cast<std::uint64_t>(INT64_MAX)
                          : value_->is_number_integer();
    if (!fits || value_->get<std::int64_t>() < low || value_->get<std::int64_t>() > high) {
      refuse("must be an integer from " + std::to_string(low) + " to " + std::to_string(high) + ", is " +
             shorten(*value_));
      return low;
    }
    return value_->get<std::int64_t>();
  }
  [[nodiscard]] std::int64_t time() const { return integer(0, kMaxTimeUs); }

  /// The file says what it is.
  void expect(const char* schema) const {
    const Reader given = (*this)["schema"];
    const std::string name = given.text();
    if (!failed() && name != schema)
      given.refuse("is \"" + name + "\", expected \"" + schema + "\"", "is this the right file?");
    const Reader version = (*this)["version"];
    const std::int64_t number = version.integer(0, INT32_MAX);
    if (!failed() && number != 1)
      version.refuse("is " + std::to_string(number) + ", this program reads version 1");
  }

 private:
  Context& context_;
  const json* value_;
  std::string path_;
};

/// Puts the file's name before the place that a validator names.
Status in_file(Status status, std::string_view origin) {
  if (status) return status;
  Error error = std::move(status).error();
  error.where = error.where.empty() ? std::string(origin) : std::string(origin) + ": " + error.where;
  return tl::unexpected<Error>(std::move(error));
}

Status status_of(Reader::Context& context) {
  if (context.error) return tl::unexpected<Error>(std::move(*context.error));
  return {};
}

/// [["u", "v"], …] by XNode name.
using NameIndex = std::unordered_map<std::string, int>;
std::vector<std::pair<int, int>> read_pairs(const Reader& reader, const NameIndex& index) {
  std::vector<std::pair<int, int>> pairs;
  reader.each_element(kMaxEdges, [&](std::size_t, const Reader& pair) {
    int ends[2] = {-1, -1};
    std::size_t count = 0;
    pair.each_element(2, [&](std::size_t i, const Reader& end) {
      const std::string name = end.text();
      if (end.failed()) return;
      const auto found = index.find(name);
      if (found == index.end()) return end.refuse("XNode '" + name + "' is not in the app");
      ends[i] = found->second;
      ++count;
    });
    if (!pair.failed() && count != 2) pair.refuse("must name two XNodes");
    pairs.emplace_back(ends[0], ends[1]);
  });
  return pairs;
}

template <class Node>
NameIndex index_by_name(const std::vector<Node>& nodes) {
  NameIndex index;
  for (std::size_t i = 0; i < nodes.size(); ++i) index.try_emplace(nodes[i].name, static_cast<int>(i));
  return index;
}

template <class Names>
ordered_json pairs_to_json(const std::vector<std::pair<int, int>>& pairs, const Names& name) {
  ordered_json out = ordered_json::array();
  for (const auto& [u, v] : pairs) out.push_back({name(u), name(v)});
  return out;
}

std::string dump(const ordered_json& document) {
  return document.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace

// ---- readers ---------------------------------------------------------------------------------------

Result<AppSpec> parse_app(std::string_view text, std::string_view origin) {
  XAUTO_ASSIGN(const json document, parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.app");
  AppSpec app;
  app.name = root["name"].text();
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    XNodeSpec spec{x["name"].text(), x["module"].text(), {}};
    x["wcet_us"].each_member([&](const std::string& type, const Reader& us) {
      spec.wcet_us[type] = us.integer(1, kMaxTimeUs);
    });
    app.xnodes.push_back(std::move(spec));
  });
  if (!root.failed()) app.edges = read_pairs(root["edges"], index_by_name(app.xnodes));
  if (root.has("deadline_us")) app.deadline_us = root["deadline_us"].integer(1, kMaxTimeUs);
  XAUTO_TRY(status_of(context));
  XAUTO_TRY(in_file(validate(app), origin));
  return app;
}

Result<Platform> parse_platform(std::string_view text, std::string_view origin) {
  XAUTO_ASSIGN(const json document, parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.platform");
  Platform platform;
  platform.name = root["name"].text();
  root["xpus"].each_element(kMaxXpus, [&](std::size_t, const Reader& x) {
    Xpu xpu;
    xpu.id = x["id"].text();
    xpu.type = x["type"].text();
    if (x.has("preemptive")) xpu.preemptive = x["preemptive"].boolean();
    if (x.has("preempt_us")) xpu.preempt_us = x["preempt_us"].time();
    if (x.has("timeslice_us")) xpu.timeslice_us = x["timeslice_us"].time();
    if (x.has("switch_us")) xpu.switch_us = x["switch_us"].time();
    platform.xpus.push_back(std::move(xpu));
  });
  XAUTO_TRY(status_of(context));
  XAUTO_TRY(in_file(validate(platform), origin));
  return platform;
}

Result<Profile> parse_profile(std::string_view text, std::string_view origin) {
  XAUTO_ASSIGN(const json document, parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.profile");
  Profile profile;
  profile.app = root["app"].text();
  const Reader conditions = root["conditions"];
  ProfileConditions& c = profile.conditions;
  c.machine = conditions["machine"].text();
  c.platform = conditions["platform"].text();
  c.emulated = conditions["emulated"].boolean();
  c.input = conditions["input"].text();
  c.warmup = conditions["warmup"].integer(0, kMaxTimeUs);
  c.repetitions = conditions["repetitions"].integer(0, kMaxTimeUs);
  c.governor = conditions["governor"].text();
  profile.margin_pct = root["margin_pct"].integer(0, 1000);
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    XNodeProfile node{x["name"].text(), x["module"].text(), {}};
    x["on"].each_member([&](const std::string& xpu, const Reader& s) {
      node.on[xpu] = {s["count"].integer(1, kMaxTimeUs), s["min_us"].time(), s["p50_us"].time(),
                      s["p99_us"].time(), s["max_us"].time()};
    });
    profile.xnodes.push_back(std::move(node));
  });
  if (!root.failed()) profile.edges = read_pairs(root["edges"], index_by_name(profile.xnodes));
  XAUTO_TRY(status_of(context));
  XAUTO_TRY(in_file(validate(profile), origin));
  return profile;
}

Result<Policy> parse_policy(std::string_view text, std::string_view origin, const AppSpec& app,
                            const Platform& platform) {
  XAUTO_ASSIGN(const json document, parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.policy");
  Policy policy;
  policy.app = root["app"].text();
  policy.app_hash = root["app_hash"].text();
  if (root.has("platform")) policy.platform = root["platform"].text();
  policy.method = root["method"].text();
  const NameIndex index = index_by_name(app.xnodes);
  policy.placements.resize(app.xnodes.size());
  std::vector<char> placed(app.xnodes.size(), 0);
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    const std::string name = x["name"].text();
    if (x.failed()) return;
    const auto found = index.find(name);
    if (found == index.end()) return x["name"].refuse("XNode '" + name + "' is not in the app");
    const auto i = static_cast<std::size_t>(found->second);
    if (placed[i]) return x["name"].refuse("XNode '" + name + "' is placed twice");
    placed[i] = 1;
    const std::string xpu = x["xpu"].text();
    Placement& p = policy.placements[i];
    p.xpu = platform.find(xpu);
    if (!x.failed() && p.xpu < 0)
      return x["xpu"].refuse("XPU '" + xpu + "' is not in platform '" + platform.name + "'");
    p.priority = x["priority"].integer(-kMaxTimeUs, kMaxTimeUs);
    p.start_us = x["start_us"].time();
    p.finish_us = x["finish_us"].time();
  });
  if (!root.failed())
    for (std::size_t i = 0; i < placed.size(); ++i)
      if (!placed[i]) {
        root["xnodes"].refuse("XNode '" + app.xnodes[i].name + "' is not placed");
        break;
      }
  if (root.has("order")) policy.order = read_pairs(root["order"], index);
  policy.latency_us = root["latency_us"].time();
  policy.lower_bound_us = root["lower_bound_us"].time();
  policy.optimal = root["optimal"].boolean();
  if (root.has("worst_case_us")) policy.worst_case_us = root["worst_case_us"].time();
  if (root.has("solve_ms")) policy.solve_ms = root["solve_ms"].integer(0, kMaxTimeUs);
  XAUTO_TRY(status_of(context));
  XAUTO_TRY(in_file(validate(policy, app, platform), origin));
  return policy;
}

// ---- writers ---------------------------------------------------------------------------------------

std::string to_json(const AppSpec& app) {
  ordered_json xnodes = ordered_json::array();
  for (const XNodeSpec& x : app.xnodes)
    xnodes.push_back({{"name", x.name}, {"module", x.module}, {"wcet_us", ordered_json(x.wcet_us)}});
  ordered_json document = {{"schema", "xauto.app"}, {"version", 1}, {"name", app.name}};
  document["xnodes"] = std::move(xnodes);
  document["edges"] = pairs_to_json(
      app.edges, [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; });
  if (app.deadline_us) document["deadline_us"] = *app.deadline_us;
  return dump(document);
}

std::string to_json(const Platform& platform) {
  ordered_json xpus = ordered_json::array();
  for (const Xpu& x : platform.xpus) {
    ordered_json xpu = {{"id", x.id},
                        {"type", x.type},
                        {"preemptive", x.preemptive},
                        {"preempt_us", x.preempt_us},
                        {"timeslice_us", x.timeslice_us}};
    if (x.switch_us >= 0) xpu["switch_us"] = x.switch_us;
    xpus.push_back(std::move(xpu));
  }
  ordered_json document = {{"schema", "xauto.platform"}, {"version", 1}, {"name", platform.name}};
  document["xpus"] = std::move(xpus);
  return dump(document);
}

std::string to_json(const Profile& profile) {
  const ProfileConditions& c = profile.conditions;
  ordered_json xnodes = ordered_json::array();
  for (const XNodeProfile& x : profile.xnodes) {
    ordered_json on = ordered_json::object();
    for (const auto& [xpu, s] : x.on)
      on[xpu] = {{"count", s.count},   {"min_us", s.min_us}, {"p50_us", s.p50_us},
                 {"p99_us", s.p99_us}, {"max_us", s.max_us}};
    xnodes.push_back({{"name", x.name}, {"module", x.module}, {"on", std::move(on)}});
  }
  ordered_json document = {{"schema", "xauto.profile"}, {"version", 1}, {"app", profile.app}};
  document["conditions"] = {{"machine", c.machine},         {"platform", c.platform},
                            {"emulated", c.emulated},       {"input", c.input},
                            {"warmup", c.warmup},           {"repetitions", c.repetitions},
                            {"governor", c.governor}};
  document["margin_pct"] = profile.margin_pct;
  document["xnodes"] = std::move(xnodes);
  document["edges"] = pairs_to_json(
      profile.edges, [&](int i) { return profile.xnodes[static_cast<std::size_t>(i)].name; });
  return dump(document);
}

std::string to_json(const Policy& policy, const AppSpec& app, const Platform& platform) {
  const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
  ordered_json xnodes = ordered_json::array();
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    const Placement& p = policy.placements[i];
    xnodes.push_back({{"name", app.xnodes[i].name},
                      {"xpu", platform.xpus[static_cast<std::size_t>(p.xpu)].id},
                      {"priority", p.priority},
                      {"start_us", p.start_us},
                      {"finish_us", p.finish_us}});
  }
  ordered_json document = {{"schema", "xauto.policy"}, {"version", 1},
                           {"app", policy.app},        {"app_hash", policy.app_hash},
                           {"platform", policy.platform}, {"method", policy.method}};
  document["xnodes"] = std::move(xnodes);
  if (!policy.order.empty()) document["order"] = pairs_to_json(policy.order, name);
  document["latency_us"] = policy.latency_us;
  document["lower_bound_us"] = policy.lower_bound_us;
  document["optimal"] = policy.optimal;
  if (policy.worst_case_us) document["worst_case_us"] = *policy.worst_case_us;
  document["solve_ms"] = policy.solve_ms;
  return dump(document);
}

// ---- files -----------------------------------------------------------------------------------------

Result<std::string> read_file(const std::string& path) {
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0)
    return fail(errno == ENOENT ? ErrorCode::kNotFound : ErrorCode::kInvalid,
                std::string("cannot be opened: ") + strerror(errno), path);
  struct Closer {
    int fd;
    ~Closer() { close(fd); }
  } const closer{fd};
  struct stat status {};
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode))
    return fail(ErrorCode::kInvalid, "is not a regular file", path);
  if (static_cast<std::size_t>(status.st_size) > kMaxFileBytes)
    return fail(ErrorCode::kInvalid, "is longer than " + std::to_string(kMaxFileBytes) + " bytes", path);
  std::string text(static_cast<std::size_t>(status.st_size), '\0');
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t got = pread(fd, text.data() + done, text.size() - done, static_cast<off_t>(done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return fail(ErrorCode::kIo, std::string("cannot be read: ") + strerror(errno), path);
    if (got == 0) break;
    done += static_cast<std::size_t>(got);
  }
  text.resize(done);
  return text;
}

Status write_file(const std::string& path, std::string_view text) {
  const std::string beside = path + ".tmp." + std::to_string(getpid());
  const int fd = open(beside.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0)
    return fail(ErrorCode::kNotFound, std::string("cannot be written: ") + strerror(errno), path);
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t wrote = write(fd, text.data() + done, text.size() - done);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote <= 0) break;
    done += static_cast<std::size_t>(wrote);
  }
  const bool good = close(fd) == 0 && done == text.size() && rename(beside.c_str(), path.c_str()) == 0;
  if (good) return {};
  const int error = errno;
  unlink(beside.c_str());
  return fail(ErrorCode::kIo, std::string("cannot be written: ") + strerror(error), path);
}

Result<AppSpec> load_app(const std::string& path) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  return parse_app(text, path);
}

Result<Platform> load_platform(const std::string& name_or_path) {
  if (auto builtin = Platform::builtin(name_or_path)) return builtin;
  auto text = read_file(name_or_path);
  if (!text) {
    Error error = std::move(text).error();
    error.hint = "use small, large, or the path of a platform.json";
    return tl::unexpected<Error>(std::move(error));
  }
  return parse_platform(*text, name_or_path);
}

Result<Profile> load_profile(const std::string& path) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  return parse_profile(text, path);
}

Result<Policy> load_policy(const std::string& path, const AppSpec& app, const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  return parse_policy(text, path, app, platform);
}

}  // namespace xauto
