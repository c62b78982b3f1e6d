// SPDX-License-Identifier: Apache-2.0
#include "processes/parameters.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <optional>

#include "model/app.h"
#include "model/json_value.h"

namespace xauto::runtime {
namespace {

using Words = std::uint64_t[kParameterWords];

/// Word 0 is a number, or the length of the text behind it.
void encode(const ParameterValue& value, Words& words) {
  words[0] = bits_of(value);
  if (type_of(value) != ParameterType::kText) return;
  const auto& text = std::get<std::string>(value);
  words[0] = std::min(text.size(), kMaxParameterText);
  std::memcpy(words + 1, text.data(), words[0]);
}

std::string_view text_in(const std::uint64_t* words) {
  return {reinterpret_cast<const char*>(words + 1),
          std::min<std::uint64_t>(words[0], kMaxParameterText)};
}

/// How many words of it count. Any text: it is cut.
std::size_t words_of(ParameterType type, std::uint64_t first) {
  if (type != ParameterType::kText) return 1;
  return 1 + (std::min<std::uint64_t>(first, kMaxParameterText) + 7) / 8;
}

/// Acquired one by one: who has read a word of change v + 2 has seen version v + 1.
void load(const ParameterLine& line, ParameterType type, std::uint64_t version,
          std::uint64_t* words) {
  const auto& from = line.value[version % 2];
  words[0] = from[0].load(std::memory_order_acquire);
  for (std::size_t i = 1; i < words_of(type, words[0]); ++i)
    words[i] = from[i].load(std::memory_order_acquire);
}

void store(ParameterLine& line, const ParameterValue& value, std::uint64_t version) {
  Words words{};
  encode(value, words);
  for (std::size_t i = words_of(type_of(value), words[0]); i-- > 0;)
    line.value[version % 2][i].store(words[i], std::memory_order_release);
}

ParameterValue decode(ParameterType type, const std::uint64_t* words) {
  if (type == ParameterType::kText) return std::string(text_in(words));
  return from_bits(type, words[0]);
}

ParameterType type_in(const ParameterLine& line) {
  return static_cast<ParameterType>(line.type % kParameterTypes);
}

detail::ParameterSpec spec_in(const ParameterLine& line) {
  const ParameterType type = type_in(line);
  return {line_name(line.name), decode(type, line.initial), from_bits(type, line.least),
          from_bits(type, line.most)};
}

ParameterValue value_in(const ParameterLine& line, std::uint64_t version) {
  Words words{};
  load(line, type_in(line), version, words);
  return decode(type_in(line), words);
}

std::string where_of(const std::string& module, const std::string& name) {
  return "parameter '" + name + "' of XModule '" + module + "'";
}

Result<Json> change(std::string_view request, Board* board) {
  const auto malformed = [] {
    return fail(ErrorCode::kInvalid, "the request is malformed", {},
                "the run and the xauto tool must be of one build");
  };
  const std::optional<Json> asked = Json::parse(request);
  if (!asked || !asked->is_object()) return malformed();
  const auto module = asked->at("module").text();
  const Json& set = asked->at("set");
  if (!module || module->size() > kMaxNameBytes || !set.is_object() || set.keys().empty() ||
      std::any_of(set.keys().begin(), set.keys().end(),
                  [](const std::string& name) { return name.size() > kMaxParameterName; }))
    return malformed();
  if (set.keys().size() > kMaxSetAtOnce)
    return fail(ErrorCode::kInvalid,
                std::to_string(set.keys().size()) + " values are too many to be set at once", {},
                "at most " + std::to_string(kMaxSetAtOnce));
  if (board == nullptr) return fail(ErrorCode::kUnavailable, "the app has not started yet");

  const BoardShape& shape = board->shape();
  std::uint32_t m = 0;
  while (m < shape.modules && line_name(board->module(static_cast<int>(m)).name) != *module) ++m;
  if (m == shape.modules)
    return fail(ErrorCode::kNotFound, "the app has no XModule '" + *module + "'", {},
                "`xauto param list` shows those with parameters");
  std::atomic<std::uint64_t>& said = board->module(static_cast<int>(m)).parameters;
  const std::uint64_t version = said.load();
  std::map<std::string, ParameterLine*> lines;
  for (std::uint32_t p = 0; p < shape.parameters; ++p)
    if (board->parameter(p).module == m)
      lines.emplace(line_name(board->parameter(p).name), &board->parameter(p));
  if (version == 0 && !lines.empty())
    return fail(ErrorCode::kUnavailable, "the app has not started yet");

  std::map<ParameterLine*, ParameterValue> values;
  Json was = Json::object();
  for (std::size_t i = 0; i < set.keys().size(); ++i) {
    const std::string& name = set.keys()[i];
    const auto at = lines.find(name);
    if (at == lines.end())
      return fail(ErrorCode::kNotFound, "XModule '" + *module + "' has no parameter '" + name + "'",
                  {}, "`xauto param list` shows what there is");
    const auto text = set.elements()[i].text();
    if (!text) return malformed();
    auto value = spec_in(*at->second).take_text(*text);
    if (!value) {
      Error error = std::move(value).error();
      error.where = where_of(*module, name);
      return tl::unexpected<Error>(std::move(error));
    }
    was[name] = to_text(value_in(*at->second, version));
    values.emplace(at->second, *std::move(value));
  }
  for (const auto& [name, line] : lines) {
    const auto changed = values.find(line);
    store(*line, changed != values.end() ? changed->second : value_in(*line, version), version + 1);
    if (changed != values.end()) line->changes.fetch_add(1);
  }
  said.store(version + 1);
  Json answer = Json::object();
  answer["was"] = std::move(was);
  return answer;
}

}  // namespace

Result<std::vector<std::vector<ParameterValue>>> first_values(const Graph& graph,
                                                              const Deployment& deployment) {
  constexpr const char* kWhere = "deployment.json";
  for (const auto& [name, said] : deployment.modules)
    if (!said.parameters.empty() &&
        std::none_of(graph.modules.begin(), graph.modules.end(),
                     [at = &name](const Graph::Module& m) { return m.name == *at; }))
      return fail(ErrorCode::kInvalid, "XModule '" + name + "' is not in the program", kWhere);
  std::vector<std::vector<ParameterValue>> all;
  for (const Graph::Module& module : graph.modules) {
    std::vector<ParameterValue>& values = all.emplace_back();
    const auto said = deployment.modules.find(module.name);
    std::map<std::string, ParameterValue, std::less<>> given;
    if (said != deployment.modules.end()) given = said->second.parameters;
    std::string known;
    for (const detail::ParameterHandle& parameter : module.parameters) {
      known += (known.empty() ? "it has " : ", ") + parameter->name;
      values.push_back(parameter->initial);
      const auto found = given.find(parameter->name);
      if (found == given.end()) continue;
      auto taken = parameter->take(found->second);
      if (!taken) {
        Error error = std::move(taken).error();
        error.where = std::string(kWhere) + ": " + where_of(module.name, parameter->name);
        return tl::unexpected<Error>(std::move(error));
      }
      values.back() = *std::move(taken);
      given.erase(found);
    }
    if (!given.empty())
      return fail(ErrorCode::kInvalid,
                  "XModule '" + module.name + "' has no parameter '" + given.begin()->first + "'",
                  kWhere,
                  known.empty() ? "the program declares none (XModule::add_parameter)" : known);
  }
  return all;
}

Status post_parameters(Board& board, const Graph& graph, const Deployment& deployment) {
  XAUTO_ASSIGN(const auto values, first_values(graph, deployment));
  std::size_t at = 0;
  for (std::size_t m = 0; m < graph.modules.size(); ++m) {
    const Graph::Module& module = graph.modules[m];
    for (std::size_t p = 0; p < module.parameters.size(); ++p) {
      const detail::ParameterSpec& parameter = *module.parameters[p];
      ParameterLine& line = board.parameter(at++);
      name_line(line.name, parameter.name);
      line.module = static_cast<std::uint32_t>(m);
      line.type = static_cast<std::uint32_t>(parameter.type());
      encode(parameter.initial, line.initial);
      line.least = bits_of(parameter.least);
      line.most = bits_of(parameter.most);
      store(line, values[m][p], 1);
    }
    board.module(static_cast<int>(m)).parameters.store(1);
  }
  return {};
}

ParameterReader::ParameterReader(const Board& board, const Graph& graph, int module) {
  std::size_t first = 0;
  for (int m = 0; m < module; ++m)
    first += graph.modules[static_cast<std::size_t>(m)].parameters.size();
  now_ = detail::initial_of(graph.modules[static_cast<std::size_t>(module)].parameters);
  if (now_.empty()) return;
  said_ = &board.module(module).parameters;
  lines_ = &board.parameter(first);
  room_.resize(now_.size() * kParameterWords);
}

void ParameterReader::look() {
  if (said_ == nullptr) return;
  for (int i = 0; i < kTries; ++i) {
    const std::uint64_t version = said_->load(std::memory_order_acquire);
    if (version == version_ || copy(version)) return;
  }
}

bool ParameterReader::copy(std::uint64_t version) {
  for (std::size_t i = 0; i < now_.size(); ++i)
    load(lines_[i], now_[i].spec->type(), version, &room_[i * kParameterWords]);
  if (said_->load(std::memory_order_acquire) != version) return false;
  for (std::size_t i = 0; i < now_.size(); ++i) {
    const std::uint64_t* words = &room_[i * kParameterWords];
    now_[i].bits = words[0];
    if (now_[i].spec->type() == ParameterType::kText) now_[i].text = text_in(words);
  }
  version_ = version;
  return true;
}

Result<std::vector<PostedParameter>> posted_parameters(const Board& board) {
  std::vector<PostedParameter> all;
  for (std::uint32_t p = 0; p < board.shape().parameters; ++p) {
    const ParameterLine& line = board.parameter(p);
    if (line.module >= board.shape().modules) continue;
    const ModuleLine& module = board.module(static_cast<int>(line.module));
    const std::uint64_t version = module.parameters.load();
    if (version == 0) return fail(ErrorCode::kUnavailable, "the app has not started yet");
    all.push_back(
        {line_name(module.name), spec_in(line), value_in(line, version), line.changes.load()});
  }
  return all;
}

std::string change_parameters(std::string_view request, Board* board) {
  return to_answer(change(request, board));
}

std::string to_answer(const Result<Json>& done) {
  if (done) return done->dump();
  const Error& error = done.error();
  return Json{{"error", Json{{"code", static_cast<int>(error.code)},
                             {"what", error.what},
                             {"where", error.where},
                             {"hint", error.hint}}}}
      .dump();
}

Status answer_error(std::string_view answer) {
  const std::optional<Json> parsed = Json::parse(answer);
  if (parsed && parsed->at("was").is_object()) return {};
  if (!parsed || !parsed->at("error").is_object())
    return fail(ErrorCode::kInvalid, "the run answered with something else than was asked", {},
                "the run and the xauto tool must be of one build");
  const Json& error = parsed->at("error");
  const auto text = [&](const char* key) { return error.at(key).text().value_or(""); };
  const std::int64_t code = error.at("code").integer().value_or(0);
  return fail(code < 0 || code > static_cast<int>(ErrorCode::kInternal)
                  ? ErrorCode::kInvalid
                  : static_cast<ErrorCode>(code),
              text("what"), text("where"), text("hint"));
}

std::string changed_parameters(const Board& board) {
  const auto posted = posted_parameters(board);
  std::string list;
  for (const PostedParameter& one : posted.value_or(std::vector<PostedParameter>()))
    if (one.changes > 0)
      list += (list.empty() ? "" : ", ") + one.module + " " + one.spec.name + " (" +
              std::to_string(one.changes) + " times, now " + to_text(one.value) + ")";
  if (list.empty()) return {};
  return "parameters were changed during the run, which may not be the values that WCETs were "
         "measured with: " +
         list;
}

}  // namespace xauto::runtime
