// SPDX-License-Identifier: Apache-2.0
#include "record/recording.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "record/storage.h"

namespace xauto::record {

struct Recording::File {
  std::unique_ptr<Reader> reader;  ///< null: read to its end
  std::string path;
  std::vector<std::size_t> topic_of;  ///< [the reader's topic] -> ours
  std::int64_t start_ns = 0;
  bool begun = false;
  std::optional<Message> head;  ///< the next message, of one that was begun
};

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxMetadataBytes = 4u << 20;

/// What metadata.yaml of a folder says. It is rosbag2's own layout that is read, line by line.
struct Metadata {
  /// rosbag2 can compress each message of an SQLite file by itself. Only metadata.yaml tells.
  bool messages_compressed = false;
  std::vector<std::string> files;             ///< names
  std::optional<std::uint64_t> num_messages;  ///< of all files
};

std::string_view unquoted(std::string_view text) {
  const std::size_t begin = text.find_first_not_of(" \t\r\"'");
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(" \t\r\"'") - begin + 1);
}

Metadata read_metadata(const fs::path& folder) {
  std::ifstream in(folder / "metadata.yaml");
  std::string text(kMaxMetadataBytes, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  Metadata found;
  bool in_files = false;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const std::string_view item = unquoted(line);
    if (in_files && item.starts_with("- ")) {
      if (found.files.size() < kMaxFiles)
        found.files.push_back(fs::path(unquoted(item.substr(2))).filename().string());
      continue;
    }
    in_files = false;
    // Keys of the bag have two spaces before them, those of its topics and files more.
    if (!line.starts_with("  ") || line.starts_with("   ")) continue;
    const std::size_t colon = item.find(':');
    if (colon == std::string_view::npos) continue;
    const std::string_view key = item.substr(0, colon), value = unquoted(item.substr(colon + 1));
    in_files = key == "relative_file_paths";
    if (key == "compression_mode") {
      std::string mode(value);
      std::transform(mode.begin(), mode.end(), mode.begin(),
                     [](unsigned char c) { return std::tolower(c); });
      found.messages_compressed = mode.find("message") != std::string::npos;
    }
    std::uint64_t count = 0;
    if (key == "message_count" &&
        std::from_chars(value.data(), value.data() + value.size(), count).ec == std::errc())
      found.num_messages = count;
  }
  return found;
}

}  // namespace

/// The files of a rosbag2 folder, in the order of their numbers; any other path as it is.
Result<Found> find_files(const std::string& path) {
  std::error_code error;
  if (!fs::is_directory(path, error)) return Found{{path}, false, {}, {}};
  Metadata metadata = read_metadata(path);
  std::vector<std::string> mcap, sqlite, compressed;
  for (fs::directory_iterator entry(path, error), end; !error && entry != end;
       entry.increment(error)) {
    const fs::path& file = entry->path();
    if (file.extension() == ".mcap") mcap.push_back(file.string());
    if (file.extension() == ".db3") sqlite.push_back(file.string());
    if (file.extension() == ".zstd" || file.extension() == ".lz4")
      compressed.push_back(file.filename().string());
  }
  if (error) return fail(ErrorCode::kInvalid, "cannot be listed: " + error.message(), path);
  if (mcap.empty() && sqlite.empty() && !compressed.empty())
    return fail(ErrorCode::kInvalid, "holds compressed files, such as " + shown(compressed.front()),
                path, "`ros2 bag convert` or `zstd -d` unpacks them");
  if (mcap.empty() && sqlite.empty())
    return fail(ErrorCode::kInvalid, "holds no .mcap file and no .db3 file", path,
                "a rosbag2 folder has one or several");
  if (!mcap.empty() && !sqlite.empty())
    return fail(ErrorCode::kInvalid, "holds .mcap files and .db3 files", path,
                "name the one to read");
  if (!sqlite.empty() && metadata.messages_compressed)
    return fail(ErrorCode::kInvalid, "holds messages that are compressed one by one", path,
                "`ros2 bag convert` makes a bag without that");
  std::vector<std::string>& found = mcap.empty() ? sqlite : mcap;
  if (found.size() > kMaxFiles)
    return fail(
        ErrorCode::kInvalid,
        "holds " + std::to_string(found.size()) + " files, more than " + std::to_string(kMaxFiles),
        path, "name the one to read");
  std::sort(found.begin(), found.end(), [](const std::string& a, const std::string& b) {
    return a.size() != b.size() ? a.size() < b.size() : a < b;  // bag_9 before bag_10
  });
  return Found{std::move(found), true, std::move(metadata.files), metadata.num_messages};
}

namespace {

Result<std::unique_ptr<Reader>> open_file(const std::string& path) {
  std::error_code error;
  const auto status = fs::status(path, error);
  if (!fs::exists(status)) return fail(ErrorCode::kNotFound, "there is no such recording", path);
  if (!fs::is_regular_file(status)) return fail(ErrorCode::kInvalid, "is not a regular file", path);
  const std::string suffix = fs::path(path).extension().string();
  if (suffix == ".mcap") return open_mcap(path);
  if (suffix == ".db3") return open_sqlite(path);
  return fail(ErrorCode::kInvalid, "is neither .mcap nor .db3", path,
              "recorded inputs are rosbag2's: such a file, or a folder of them");
}

}  // namespace

std::string shown(std::string text) {
  if (text.size() > 60) text = text.substr(0, 57) + "...";
  for (char& c : text)
    if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) >= 0x7f) c = '?';
  return "'" + text + "'";
}

Recording::Recording(Recording&&) noexcept = default;
Recording& Recording::operator=(Recording&&) noexcept = default;
Recording::~Recording() = default;

std::string gap_text(std::int64_t from_ns, std::int64_t to_ns) {
  const auto length = [](double seconds) {
    if (seconds < 7200) return fmt::format("{:.1f} minutes", seconds / 60);
    if (seconds < 172'800) return fmt::format("{:.1f} hours", seconds / 3600);
    if (seconds < 63'115'200) return fmt::format("{:.1f} days", seconds / 86'400);
    return fmt::format("{:.1f} years", seconds / 31'557'600);
  };
  const auto instant = [](std::int64_t ns) {
    const std::time_t seconds = ns / 1'000'000'000;
    std::tm utc{};
    gmtime_r(&seconds, &utc);
    return fmt::format("{:04}-{:02}-{:02} {:02}:{:02}:{:02}.{:03}", utc.tm_year + 1900,
                       utc.tm_mon + 1, utc.tm_mday, utc.tm_hour, utc.tm_min, utc.tm_sec,
                       ns / 1'000'000 % 1000);
  };
  return fmt::format("{} without a message, from {} to {} UTC",
                     length(static_cast<double>(to_ns - from_ns) * 1e-9), instant(from_ns),
                     instant(to_ns));
}

Result<Recording> Recording::open(const std::string& given) {
  Recording r;
  r.path_ = given;
  XAUTO_ASSIGN(const Found found, find_files(given));
  if (found.files.size() == 1) r.path_ = found.files.front();
  std::optional<Error> first;  // of the files of which nothing can be read
  bool any = false;
  for (const std::string& path : found.files) {
    auto reader = open_file(path);
    if (!reader && found.folder && reader.error().code == ErrorCode::kInvalid) {
      r.tell(path, "nothing of it can be read: " + reader.error().what);
      if (!first) first = std::move(reader).error();
      continue;
    }
    if (!reader) return tl::unexpected<Error>(std::move(reader).error());
    XAUTO_TRY(r.add(std::move(*reader), path));
    any = true;
  }
  if (!any && first) return tl::unexpected<Error>(std::move(*first));
  const std::string why = found.folder && !r.note_.empty() ? ": " + r.note_ : "";
  if (r.topics_.empty()) return fail(ErrorCode::kInvalid, "has no topics" + why, r.path_);
  if (r.num_messages_ == 0) return fail(ErrorCode::kInvalid, "has no messages" + why, r.path_);
  for (const std::string& name : found.named)
    if (std::error_code error; !fs::exists(fs::path(given) / name, error))
      r.tell(given, "metadata.yaml names " + shown(name) + ", which is not there");
  if (const auto said = found.num_messages; said && *said > r.num_messages_)
    r.tell(given, "metadata.yaml counts " + std::to_string(*said) + " messages, " +
                      std::to_string(r.num_messages_) + " are there");
  return r;
}

void Recording::tell(const std::string& path, const std::string& what) {
  if (!note_.empty()) note_ += "\n";
  note_ += path + ": " + what;
}

Status Recording::add(std::unique_ptr<Reader> reader, const std::string& path) {
  if (const std::string note = reader->note(); !note.empty()) tell(path, note);
  auto file = std::make_unique<File>();
  for (const Topic& topic : reader->topics()) {
    const auto [at, is_new] = topic_at_.try_emplace(topic.name, topics_.size());
    file->topic_of.push_back(at->second);
    if (is_new) {
      topics_.push_back(topic);
      continue;
    }
    const Topic& same = topics_[at->second];
    if (same.type != topic.type || same.serialization_format != topic.serialization_format)
      return fail(ErrorCode::kInvalid,
                  "topic " + shown(topic.name) + " has another type than in the files before",
                  path);
  }
  if (topics_.size() > kMaxTopics)
    return fail(ErrorCode::kInvalid, "has more than " + std::to_string(kMaxTopics) + " topics",
                path_);
  if (reader->num_messages() == 0) return {};  // the last of a split bag may be
  XAUTO_ASSIGN(file->start_ns, reader->start_ns());
  num_messages_ += reader->num_messages();
  file->path = path;
  file->reader = std::move(reader);
  files_.push_back(std::move(file));
  return {};
}

Status Recording::fetch(File& file) {
  XAUTO_ASSIGN(file.head, file.reader->next());
  if (!file.head) file.reader.reset();  // and so its memory
  return {};
}

Result<std::optional<Message>> Recording::next() {
  thread_.check();
  const auto time = [](const File& file) {
    return file.head ? file.head->timestamp_ns : file.start_ns;
  };
  for (;;) {
    // Of what may be next, the earliest; of equals, the one in the file before.
    File* first = nullptr;
    for (const auto& file : files_) {
      if (file->begun && file->reader && !file->head) XAUTO_TRY(fetch(*file));
      if (file->reader && (first == nullptr || time(*file) < time(*first))) first = file.get();
    }
    if (first == nullptr) return std::optional<Message>();
    if (!first->begun) {
      first->begun = true;
      continue;
    }
    std::optional<Message> message = std::exchange(first->head, std::nullopt);
    if (message->timestamp_ns < last_ns_)
      return fail(ErrorCode::kInvalid, "is damaged: its messages are earlier than it says",
                  first->path);
    last_ns_ = message->timestamp_ns;
    message->topic = first->topic_of[message->topic];
    return message;
  }
}

Status Recording::verify() {
  for (const auto& file : files_)
    if (file->reader) XAUTO_TRY(file->reader->verify());
  return {};
}

}  // namespace xauto::record
