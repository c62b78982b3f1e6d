// SPDX-License-Identifier: Apache-2.0
// xauto recording: what is in a recorded input (info), whether it can be read to its end (check), and what can be read of one
// that is damaged, as a new one (repair).
// Recording itself is `xauto run --record FILE`.
#include <cmath>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/log.h"
#include "model/json_value.h"
#include "record/recording.h"
#include "record/salvage.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

/// Reads a recording to its end, with progress.
struct Contents {
  std::vector<record::Topic> topics;
  std::vector<std::uint64_t> messages, bytes;  ///< per topic
  std::uint64_t num_messages = 0;
  double seconds = 0;
  std::string note;               ///< why it is not all that was recorded
  std::vector<std::string> gaps;  ///< the first of them, for people
  std::uint64_t num_gaps = 0;
};
constexpr std::size_t kMaxGapsTold = 5;

Result<Contents> read(const std::string& path, bool verify) {
  XAUTO_ASSIGN(auto recording, record::Recording::open(path));
  if (verify) XAUTO_TRY(recording.verify());
  Contents c;
  c.topics = recording.topics();
  c.num_messages = recording.num_messages();
  c.note = recording.note();
  c.messages.resize(c.topics.size());
  c.bytes.resize(c.topics.size());
  std::int64_t first = -1, last = 0;
  std::uint64_t done = 0;
  Progress progress("reading", static_cast<double>(c.num_messages));
  for (;;) {
    XAUTO_ASSIGN(const auto message, recording.next());
    if (!message) break;
    if (first < 0) first = last = message->timestamp_ns;
    if (message->timestamp_ns - last > record::kGapNs && ++c.num_gaps <= kMaxGapsTold)
      c.gaps.push_back(
          fmt::format("after message {}: {}", done, record::gap_text(last, message->timestamp_ns)));
    last = message->timestamp_ns;
    ++c.messages[message->topic];
    c.bytes[message->topic] += message->data.size();
    progress.update(static_cast<double>(++done));
  }
  progress.finish();
  c.seconds = static_cast<double>(last - first) * 1e-9;
  return c;
}

int print_info(const std::string& path, const Contents& c, const Options& options) {
  Json topics = Json::array();
  std::string table = fmt::format("{}: {} messages, {:.3f} s\n", path, c.num_messages, c.seconds);
  for (std::size_t i = 0; i < c.topics.size(); ++i) {
    const record::Topic& topic = c.topics[i];
    table += row_of(topic.name, 34) +
             fmt::format("{:>9} messages {:>16} bytes\n", c.messages[i], c.bytes[i]) +
             wrapped(fmt::format("    {} ({})", topic.type, topic.serialization_format), 6) + "\n";
    topics.push_back({{"name", topic.name},
                      {"type", topic.type},
                      {"serialization_format", topic.serialization_format},
                      {"schema_encoding", topic.schema_encoding},
                      {"messages", c.messages[i]},
                      {"bytes", c.bytes[i]}});
  }
  const Json all = {{"messages", c.num_messages},
                    {"duration_us", std::llround(c.seconds * 1e6)},
                    {"topics", topics},
                    {"gaps", c.gaps},
                    {"note", c.note}};
  if (options.json)
    std::cout << all.dump(2) << "\n";
  else
    std::cout << table;
  return kDone;
}

int print_check(const std::string& path, const Contents& c, const Options& options) {
  if (options.json)
    std::cout << Json{{"readable", true},
                      {"messages", c.num_messages},
                      {"gaps", c.gaps},
                      {"note", c.note}}
                     .dump(2)
              << "\n";
  else if (c.note.empty())
    std::cout << fmt::format("{}: all {} messages can be read\n", path, c.num_messages);
  else
    std::cout << fmt::format("{}: all {} messages that are there can be read; more were recorded\n",
                             path, c.num_messages);
  return c.note.empty() ? kDone : kAnswerIsNo;
}

void warn_of(const Contents& c) {
  if (!c.note.empty()) log::warn("{}", c.note);
  for (const std::string& gap : c.gaps) log::warn("{}", gap);
  if (c.num_gaps > c.gaps.size()) log::warn("... and {} more gaps", c.num_gaps - c.gaps.size());
  if (c.num_gaps > 0)
    log::warn(
        "a clock was set meanwhile, or a stamp is wrong: a replay waits as long, unless `xauto run "
        "--max-gap 1s` shortens it");
}

Json to_json(const record::Salvaged& salvaged) {
  return {{"messages", salvaged.messages},
          {"faults", salvaged.faults},
          {"left_out", salvaged.left_out}};
}

void warn_of(const record::Salvaged& salvaged) {
  for (const std::string& what : salvaged.left_out) log::warn("left out: {}", what);
  if (salvaged.faults > salvaged.left_out.size())
    log::warn("... and {} more", salvaged.faults - salvaged.left_out.size());
}

/// A recording that cannot be read to its end: what of it can.
Result<int> check_damaged(const std::string& path, Error error, const Options& options) {
  if (error.code != ErrorCode::kInvalid) return tl::unexpected<Error>(std::move(error));
  const auto none = [](const record::Topic&, std::int64_t, std::span<const std::byte>) {
    return Status();
  };
  XAUTO_ASSIGN(const record::Salvaged salvaged, record::salvage(path, none));
  if (salvaged.messages == 0) return tl::unexpected<Error>(std::move(error));
  log::warn("{}", error.to_string());
  warn_of(salvaged);
  if (options.json) {
    Json answer = to_json(salvaged);
    answer["readable"] = false;
    std::cout << answer.dump(2) << "\n";
  } else {
    std::cout << fmt::format(
        "{}: {} messages can be read, with {} faults between them; `xauto recording repair` writes "
        "them\n",
        path, salvaged.messages, salvaged.faults);
  }
  return kAnswerIsNo;
}

Result<int> repair(const std::string& path, const std::string& out, const Options& options) {
  namespace fs = std::filesystem;
  if (out.empty())
    return fail(ErrorCode::kInvalid, "no name for what is repaired", "recording repair",
                "xauto recording repair " + path + " repaired.mcap");
  std::error_code error;
  if (fs::is_directory(path, error) && fs::equivalent(fs::absolute(out).parent_path(), path, error))
    return fail(ErrorCode::kInvalid, "would be a part of the recording that it is made of", out,
                "name a place outside of its folder");
  XAUTO_ASSIGN(auto recorder, record::Recorder::create(out));
  std::map<std::string, std::pair<std::string, std::size_t>> topics;  // name -> type, index
  std::uint64_t other_type = 0;
  const auto take = [&](const record::Topic& topic, std::int64_t timestamp_ns,
                        std::span<const std::byte> data) -> Status {
    auto found = topics.find(topic.name);
    if (found == topics.end()) {
      XAUTO_ASSIGN(const std::size_t index, recorder.add_topic(topic));
      found = topics.try_emplace(topic.name, topic.type, index).first;
    }
    if (found->second.first != topic.type) {
      ++other_type;
      return {};
    }
    return recorder.write(found->second.second, timestamp_ns, data);
  };
  auto salvaged = record::salvage(path, take);
  const Status closed = recorder.close();
  if (!salvaged || !closed || salvaged->messages == 0) {
    fs::remove_all(out, error);  // made here, a moment ago
    if (!salvaged) return tl::unexpected<Error>(std::move(salvaged).error());
    XAUTO_TRY(closed);
    warn_of(*salvaged);
    return fail(ErrorCode::kInvalid, "no message of it can be read", path);
  }
  if (other_type > 0) {
    salvaged->messages -= other_type;
    salvaged->leave_out(
        path, fmt::format("{} messages of another type than their topic had before", other_type));
  }
  warn_of(*salvaged);
  if (options.json)
    std::cout << to_json(*salvaged).dump(2) << "\n";
  else
    std::cout << fmt::format("{}: {} messages written, {} faults left out\n", out,
                             salvaged->messages, salvaged->faults);
  return kDone;
}

}  // namespace

void add_recording(Commands& commands) {
  struct Flags {
    std::string action, path, out;
  };
  auto flags = std::make_shared<Flags>();
  Verb verb = commands.add(
      "recording",
      "Tell what is in a recorded input, or mend one; to make one: xauto run --record FILE.",
      "xauto recording info drive.mcap\n  xauto recording repair damaged.mcap mended.mcap",
      [flags](const Options& options) -> Result<int> {
        if (flags->action == "repair") return repair(flags->path, flags->out, options);
        if (!flags->out.empty())
          return fail(ErrorCode::kInvalid, "one recording at a time", flags->out);
        const bool check = flags->action == "check";
        auto contents = read(flags->path, check);
        if (!contents && check)
          return check_damaged(flags->path, std::move(contents).error(), options);
        if (!contents) return tl::unexpected<Error>(std::move(contents).error());
        warn_of(*contents);
        return check ? print_check(flags->path, *contents, options)
                     : print_info(flags->path, *contents, options);
      });
  verb.option("action", flags->action,
              "info: topics, counts, duration; check: whether all can be read and the recording is "
              "whole; repair: write what can be read of FILE to OUT")
      .required()
      .one_of({"info", "check", "repair"});
  verb.option("file", flags->path, "a .mcap file, a .db3 file or a rosbag2 folder").required();
  verb.option("out", flags->out, "of repair: what it writes, by its name .mcap or a folder");
}

}  // namespace xauto::cli
