// SPDX-License-Identifier: Apache-2.0
// xauto record: what is in a recorded input, and whether it can be read to its end. Recording itself is
// `xauto run --record FILE`.
#include <fmt/format.h>

#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>

#include "record/recording.h"
#include "xauto/command.h"

namespace xauto::cli {
namespace {

Result<int> info(const std::string& path, const Options& options) {
  XAUTO_ASSIGN(auto recording, record::Recording::open(path));
  std::vector<std::uint64_t> count(recording.topics().size(), 0), bytes(count);
  std::int64_t first = -1, last = 0;
  for (;;) {
    XAUTO_ASSIGN(const auto message, recording.next());
    if (!message) break;
    if (first < 0) first = message->timestamp_ns;
    last = message->timestamp_ns;
    ++count[message->topic];
    bytes[message->topic] += message->data.size();
  }
  const double seconds = static_cast<double>(last - first) * 1e-9;
  nlohmann::ordered_json topics = nlohmann::ordered_json::array();
  std::string table = fmt::format("{}: {} messages, {:.3f} s\n", path, recording.num_messages(), seconds);
  for (std::size_t i = 0; i < count.size(); ++i) {
    const record::Topic& topic = recording.topics()[i];
    table += fmt::format("  {:<32}{:>8} messages {:>12} bytes  {} ({})\n", topic.name, count[i], bytes[i],
                         topic.type, topic.serialization_format);
    topics.push_back({{"name", topic.name},
                      {"type", topic.type},
                      {"serialization_format", topic.serialization_format},
                      {"messages", count[i]},
                      {"bytes", bytes[i]}});
  }
  if (options.json)
    std::cout << nlohmann::ordered_json{{"messages", recording.num_messages()},
                                        {"duration_s", seconds},
                                        {"topics", topics}}
                     .dump(2)
              << "\n";
  else
    std::cout << table;
  return kDone;
}

}  // namespace

void add_record(Commands& commands) {
  auto path = std::make_shared<std::string>();
  CLI::App* verb = commands.add(
      "record", "Tell what is in a recorded input; to make one: xauto run --record FILE.",
      "xauto record drive.db3", [path](const Options& options) {
        const auto status = info(*path, options);
        return status ? *status : report(status.error());
      });
  verb->add_option("file", *path, "a .db3 file or a rosbag2 folder")->required();
}

}  // namespace xauto::cli
