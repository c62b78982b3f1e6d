// SPDX-License-Identifier: Apache-2.0
#include "model/json_parts.h"

#include <algorithm>

namespace xauto::json_parts {

Status in_file(Status status, std::string_view origin) {
  if (status) return status;
  Error error = std::move(status).error();
  error.where =
      error.where.empty() ? std::string(origin) : std::string(origin) + ": " + error.where;
  return tl::unexpected<Error>(std::move(error));
}

Status in_file_order(Error error, const std::string& list,
                     const std::vector<std::size_t>& line_of) {
  const std::string place = "/" + list + "/";
  if (error.where.starts_with(place)) {
    const std::size_t end = std::min(error.where.find('/', place.size()), error.where.size());
    const std::size_t index = std::stoul(error.where.substr(place.size(), end - place.size()));
    if (index < line_of.size())
      error.where = place + std::to_string(line_of[index]) + error.where.substr(end);
  }
  return tl::unexpected<Error>(std::move(error));
}

int read_name(const Reader& name, const NameIndex& index, const char* what, const char* list) {
  const std::string text = name.text();
  if (name.failed()) return -1;
  const auto found = index.find(text);
  if (found != index.end()) return found->second;
  name.refuse(std::string(what) + " '" + text + "' is not in " + list);
  return -1;
}

std::pair<int, int> read_pair(const Reader& pair, const NameIndex& index) {
  int ends[2] = {-1, -1};
  std::size_t count = 0;
  pair.each_element(2, [&](std::size_t i, const Reader& end) {
    ends[i] = read_name(end, index, "XNode", "the app");
    ++count;
  });
  if (!pair.failed() && count != 2) pair.refuse("must name two XNodes");
  return {ends[0], ends[1]};
}

std::vector<std::pair<int, int>> read_pairs(const Reader& reader, const NameIndex& index,
                                            std::size_t limit) {
  std::vector<std::pair<int, int>> pairs;
  reader.each_element(
      limit, [&](std::size_t, const Reader& pair) { pairs.push_back(read_pair(pair, index)); });
  return pairs;
}

std::vector<std::int64_t> read_series(const Reader& reader, const char* key, bool required) {
  // Activations of one XNode that a policy tells apart; that a file's size bounds all of them together
  // is json_document's part.
  constexpr std::size_t kMaxKeys = 1'000'000;
  std::vector<std::int64_t> times;
  if (required || reader.has(key))
    reader[key].each_element(kMaxKeys,
                             [&](std::size_t, const Reader& us) { times.push_back(us.time()); });
  return times;
}

Period read_period(const Reader& source) {
  const bool period = source.has("period_us"), rate = source.has("rate_hz");
  if (period == rate) {
    source.refuse(period ? "has both \"period_us\" and \"rate_hz\""
                         : "has neither \"period_us\" nor \"rate_hz\"");
    return {};
  }
  if (period) return {source["period_us"].integer(1, kMaxPeriodUs)};
  const Reader hz = source["rate_hz"];
  const std::string text = hz.decimal();
  if (hz.failed()) return {};
  const auto read = Period::of_rate(text);
  if (read) return *read;
  hz.refuse(read.error().what, read.error().hint);
  return {};
}

void write_period(const Period& period, ordered_json& source) {
  const std::string rate = period.rate();
  if (period.den == 1)
    source["period_us"] = period.num;
  else if (rate.find('/') == std::string::npos)
    source["rate_hz"] = std::stoll(rate);
  else
    source["rate_hz"] = rate;
}

std::vector<int> read_heard(const Reader& xnode, const NameIndex& sources) {
  std::vector<int> heard;
  if (!xnode.has("source")) return heard;
  const auto read = [&](const Reader& one) {
    heard.push_back(read_name(one, sources, "source", "\"sources\""));
  };
  const Reader source = xnode["source"];
  if (source.is_text())
    read(source);
  else
    source.each_element(kMaxSources, [&](std::size_t, const Reader& one) { read(one); });
  return heard;
}

void write_heard(const std::vector<int>& heard, const std::vector<SourceSpec>& sources,
                 ordered_json& xnode) {
  ordered_json names = ordered_json::array();
  for (const int s : heard) names.push_back(sources[static_cast<std::size_t>(s)].name);
  if (heard.size() == 1) xnode["source"] = names.front();
  if (heard.size() > 1) xnode["source"] = std::move(names);
}

}  // namespace xauto::json_parts
