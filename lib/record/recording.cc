// SPDX-License-Identifier: Apache-2.0
#include "record/recording.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <utility>

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

/// rosbag2 can compress each message of an SQLite file by itself. Only metadata.yaml tells.
bool messages_compressed(const fs::path& folder) {
  std::ifstream in(folder / "metadata.yaml");
  std::string text(kMaxMetadataBytes, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  const std::string key = "compression_mode:";
  const std::size_t at = text.find("\n  " + key);
  if (at == std::string::npos) return false;
  const std::size_t begin = at + 3 + key.size();
  std::string mode = text.substr(begin, text.find('\n', begin) - begin);
  std::transform(mode.begin(), mode.end(), mode.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return mode.find("message") != std::string::npos;
}

/// The files of a rosbag2 folder, in the order of their numbers; any other path as it is.
Result<std::vector<std::string>> resolve(const std::string& path) {
  std::error_code error;
  if (!fs::is_directory(path, error)) return std::vector<std::string>{path};
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
  if (!sqlite.empty() && messages_compressed(path))
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
  return std::move(found);
}

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

Result<Recording> Recording::open(const std::string& given) {
  Recording r;
  r.path_ = given;
  XAUTO_ASSIGN(const std::vector<std::string> paths, resolve(given));
  if (paths.size() == 1) r.path_ = paths.front();
  for (const std::string& path : paths) {
    XAUTO_ASSIGN(auto reader, open_file(path));
    XAUTO_TRY(r.add(std::move(reader), path));
  }
  if (r.topics_.empty()) return fail(ErrorCode::kInvalid, "has no topics", r.path_);
  if (r.num_messages_ == 0) return fail(ErrorCode::kInvalid, "has no messages", r.path_);
  return r;
}

Status Recording::add(std::unique_ptr<Reader> reader, const std::string& path) {
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
  if (const std::string note = reader->note(); !note.empty()) {
    if (!note_.empty()) note_ += "\n";
    note_ += path + ": " + note;
  }
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
