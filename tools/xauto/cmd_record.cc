// SPDX-License-Identifier: Apache-2.0
// xauto record: what is in a recorded input (info), and whether it can be read to its end (check).
// Recording itself is `xauto run --record FILE`.
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "base/log.h"
#include "model/json_value.h"
#include "record/recording.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

/// Reads a recording to its end, with progress.
struct Contents {
  std::vector<record::Topic> topics;
  std::vector<std::uint64_t> messages, bytes;  ///< per topic
  std::uint64_t num_messages = 0;
  double seconds = 0;
  std::string note;  ///< why it is not all that was recorded
};

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
    if (first < 0) first = message->timestamp_ns;
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
    table += fmt::format("  {:<32}{:>8} messages {:>12} bytes  {} ({})\n", topic.name,
                         c.messages[i], c.bytes[i], topic.type, topic.serialization_format);
    topics.push_back({{"name", topic.name},
                      {"type", topic.type},
                      {"serialization_format", topic.serialization_format},
                      {"schema_encoding", topic.schema_encoding},
                      {"messages", c.messages[i]},
                      {"bytes", c.bytes[i]}});
  }
  const Json all = {{"messages", c.num_messages},
                    {"duration_s", c.seconds},
                    {"topics", topics},
                    {"note", c.note}};
  if (options.json)
    std::cout << all.dump(2) << "\n";
  else
    std::cout << table;
  return kDone;
}

int print_check(const std::string& path, const Contents& c, const Options& options) {
  if (options.json)
    std::cout << Json{{"readable", true}, {"messages", c.num_messages}, {"note", c.note}}.dump(2)
              << "\n";
  else
    std::cout << fmt::format("{}: all {} messages can be read\n", path, c.num_messages);
  return c.note.empty() ? kDone : kAnswerIsNo;
}

}  // namespace

void add_record(Commands& commands) {
  struct Flags {
    std::string action, path;
  };
  auto flags = std::make_shared<Flags>();
  Verb verb = commands.add(
      "record", "Tell what is in a recorded input; to make one: xauto run --record FILE.",
      "xauto record info drive.mcap", [flags](const Options& options) -> Result<int> {
        const bool check = flags->action == "check";
        XAUTO_ASSIGN(const auto contents, read(flags->path, check));
        if (!contents.note.empty()) log::warn("{}", contents.note);
        return check ? print_check(flags->path, contents, options)
                     : print_info(flags->path, contents, options);
      });
  verb.option("action", flags->action,
              "info: topics, counts, duration; check: whether all can be read and the recording is "
              "whole")
      .required()
      .one_of({"info", "check"});
  verb.option("file", flags->path, "a .mcap file, a .db3 file or a rosbag2 folder").required();
}

}  // namespace xauto::cli
