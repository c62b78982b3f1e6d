// SPDX-License-Identifier: Apache-2.0
#include "import/nsight.h"

#include <algorithm>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "record/sqlite_file.h"

#include "import/questions.h"

namespace xauto::import {
namespace {

using record::SqliteFile;
using record::SqliteStatement;

constexpr std::uint64_t kMaxValueBytes = 64u << 20;
constexpr std::size_t kMaxDlaTables = 16;
constexpr int kPushPopRange = 59, kStartEndRange = 60, kDomainCreate = 75;  // ENUM_NSYS_EVENT_TYPE

/// A row whose columns are as they were asked for; those that the table lacks are NULL.
class Row {
 public:
  explicit Row(sqlite3_stmt* row) : row_(row) {}
  [[nodiscard]] std::optional<std::int64_t> number(int column) const {
    if (sqlite3_column_type(row_, column) != SQLITE_INTEGER) return std::nullopt;
    return sqlite3_column_int64(row_, column);
  }
  [[nodiscard]] std::int64_t number_or(int column, std::int64_t otherwise) const {
    return number(column).value_or(otherwise);
  }
  /// Start and end, in the first two columns.
  [[nodiscard]] bool times(std::int64_t& start_ns, std::int64_t& end_ns) const {
    const auto from = number(0), to = number(1);
    if (!from || !to || *from < -kMaxNsightNs || *to > kMaxNsightNs || *to < *from) return false;
    start_ns = *from;
    end_ns = *to;
    return true;
  }
  [[nodiscard]] std::optional<std::string> text(int column) const {
    if (sqlite3_column_type(row_, column) != SQLITE_TEXT) return std::nullopt;
    return record::text_of(row_, column);
  }

 private:
  sqlite3_stmt* row_;
};

class Export {
 public:
  explicit Export(SqliteFile& file) : file_(file) {
    file_.again(4); /* each table once, strings thrice */
  }

  Result<NsightTrace> read() {
    XAUTO_TRY(list_tables());
    read_ranges();
    read_names();
    for (NsightRange& range : out_.ranges) range.name = name_of(range);
    read_calls();
    for (const char* table : {"CUPTI_ACTIVITY_KIND_KERNEL", "CUPTI_ACTIVITY_KIND_MEMCPY",
                              "CUPTI_ACTIVITY_KIND_MEMSET", "CUPTI_ACTIVITY_KIND_GRAPH_TRACE"})
      if (tables_.contains(table)) read_work(table, false);
    for (const std::string& table : dla_tables_) read_work(table, true);
    if (std::ranges::none_of(out_.work, [](const NsightWork& w) { return !w.dla; }))
      note("it has no kernels and no copies: record with `nsys profile --trace=cuda,nvtx`");
    return std::move(out_);
  }

 private:
  void note(std::string line) { out_.notes.push_back(std::move(line)); }

  Status list_tables() {
    XAUTO_ASSIGN(const SqliteStatement rows,
                 file_.prepare("SELECT name FROM sqlite_master WHERE type = 'table'"));
    int step;
    while ((step = sqlite3_step(rows.get())) == SQLITE_ROW) {
      std::string name = record::text_of(rows.get(), 0);
      if (name.size() > kMaxNameBytes) continue;
      std::string upper = name;
      for (char& c : upper) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
      if (upper.find("DLA") != std::string::npos && !upper.starts_with("ENUM_") &&
          dla_tables_.size() < kMaxDlaTables)
        dla_tables_.push_back(name);
      tables_.insert(std::move(name));
    }
    if (step != SQLITE_DONE) return file_.damaged();
    if (!tables_.contains("NVTX_EVENTS"))
      return file_.broken(
          "has no table NVTX_EVENTS: it is no export of `nsys export --type sqlite`, "
          "or has no NVTX range (`nsys profile --trace=cuda,nvtx`)");
    return {};
  }

  /// Each row of a real table; the first `needed` columns are there, of the others some may be NULL. What is wrong is
  /// noted. `take` says whether it understood the row.
  void each(const std::string& table, const std::vector<const char*>& columns, std::size_t needed,
            const std::function<bool(const Row&)>& take) {
    const auto there = file_.columns_of(table);
    if (!there) return note(table + ": " + there.error().what);
    std::string sql;
    for (std::size_t c = 0; c < columns.size(); ++c) {
      if (!there->contains(columns[c]) && c < needed)
        return note(table + " has no column '" + columns[c] + "': it is left out");
      sql += (c == 0 ? "SELECT " : ", ") +
             (there->contains(columns[c]) ? '"' + std::string(columns[c]) + '"' : "NULL");
    }
    std::string quoted;
    for (const char c : table) quoted += c == '"' ? std::string(2, c) : std::string(1, c);
    const auto rows = file_.prepare(sql + " FROM \"" + quoted + "\" NOT INDEXED");
    if (!rows) return note(table + ": " + rows.error().what);
    std::size_t count = 0, wrong = 0;
    int step;
    while ((step = sqlite3_step(rows->get())) == SQLITE_ROW && count < kMaxNsightRows) {
      ++count;
      wrong += take(Row(rows->get())) ? 0 : 1;
    }
    if (wrong > 0)
      note(table + ": " + counted(wrong, "row") + " of " + std::to_string(count) +
           " have no times, or times that end before they begin");
    if (step == SQLITE_ROW)
      note(table + " has more than " + std::to_string(kMaxNsightRows) +
           " rows: the rest is left out");
    else if (step != SQLITE_DONE)
      note(table + ", after " + counted(count, "row") + ": " + file_.damaged().value().what);
  }

  struct Name {
    std::optional<std::int64_t> id;  ///< of StringIds
    std::string text;
    std::int64_t domain = 0;
  };

  void read_ranges() {
    std::size_t unended = 0, elsewhere = 0, too_many = 0;
    each("NVTX_EVENTS",
         {"start", "end", "eventType", "globalTid", "text", "textId", "domainId", "endGlobalTid"},
         4, [&](const Row& row) {
           const std::int64_t type = row.number_or(2, 0);
           if (type != kPushPopRange && type != kStartEndRange && type != kDomainCreate)
             return true;
           const std::int64_t thread = row.number_or(3, 0);
           Name name{row.number(5), bare(row.text(4).value_or("")), row.number_or(6, 0)};
           if (name.id) name.text.clear();
           if (type == kDomainCreate) {
             domains_[{process_of(thread), name.domain}] = std::move(name);
             return true;
           }
           if (!row.number(1)) {
             ++unended;
             return true;
           }
           if (row.number_or(7, thread) != thread && type == kStartEndRange) {
             ++elsewhere;
             return true;
           }
           NsightRange range;
           if (!row.times(range.start_ns, range.end_ns)) return false;
           range.thread = thread;
           const auto number = names_.try_emplace({name.id.value_or(-1), name.domain, name.text},
                                                  name_list_.size());
           if (number.second && name_list_.size() >= kMaxRangeNames) {
             names_.erase(number.first);
             ++too_many;
             return true;
           }
           if (number.second) name_list_.push_back(std::move(name));
           name_of_range_.push_back(number.first->second);
           out_.ranges.push_back(std::move(range));
           return true;
         });
    if (unended > 0) note(counted(unended, "range") + " without an end: left out");
    if (elsewhere > 0)
      note(counted(elsewhere, "range") + " with an end on another thread: left out");
    if (too_many > 0)
      note(counted(too_many, "range") + " of more than " + std::to_string(kMaxRangeNames) +
           " names: left out");
  }

  /// Those of StringIds that ranges, domains or calls name.
  void read_names() {
    std::set<std::int64_t> wanted;
    for (const Name& name : name_list_)
      if (name.id) wanted.insert(*name.id);
    for (const auto& [where, name] : domains_)
      if (name.id) wanted.insert(*name.id);
    if (!tables_.contains("StringIds")) {
      if (!wanted.empty()) note("it has no table StringIds: ranges have numbers for names");
      return;
    }
    each("StringIds", {"id", "value"}, 2, [&](const Row& row) {
      const auto id = row.number(0);
      const auto text = row.text(1);
      if (!id || !text) return false;
      if (wanted.contains(*id)) strings_[*id] = bare(*text);
      const auto has = [&](const char* word) { return text->find(word) != std::string::npos; };
      // cudaStreamSynchronize, cuCtxSynchronize, cudaMemcpy; but not cudaMemcpyAsync.
      if (text->size() < kMaxNameBytes && text->starts_with("cu") &&
          (has("Synchronize") || (has("Memcpy") && !has("Async"))))
        waiting_.insert(*id);
      return true;
    });
  }

  [[nodiscard]] std::string text_of(const Name& name) const {
    if (!name.id) return name.text;
    const auto found = strings_.find(*name.id);
    return found == strings_.end() ? "string " + std::to_string(*name.id) : found->second;
  }

  [[nodiscard]] std::string name_of(const NsightRange& range) const {
    const Name& name =
        name_list_[name_of_range_[static_cast<std::size_t>(&range - out_.ranges.data())]];
    const auto domain = domains_.find({process_of(range.thread), name.domain});
    const std::string text = text_of(name);
    return domain == domains_.end() ? text : bare(text_of(domain->second) + ":" + text);
  }

  void read_calls() {
    if (!tables_.contains("CUPTI_ACTIVITY_KIND_RUNTIME"))
      return note(
          "it has no table CUPTI_ACTIVITY_KIND_RUNTIME: whose kernels and copies are which is not "
          "known");
    each("CUPTI_ACTIVITY_KIND_RUNTIME", {"start", "end", "globalTid", "correlationId", "nameId"}, 4,
         [&](const Row& row) {
           NsightCall call;
           if (!row.times(call.start_ns, call.end_ns)) return false;
           call.thread = row.number_or(2, 0);
           call.correlation = row.number_or(3, 0);
           call.waits = waiting_.contains(row.number_or(4, -1));
           out_.calls.push_back(call);
           return true;
         });
  }

  void read_work(const std::string& table, bool dla) {
    each(table, {"start", "end", "correlationId", "globalPid", "deviceId", "globalTid"},
         dla ? 2 : 3, [&](const Row& row) {
           NsightWork work;
           if (!row.times(work.start_ns, work.end_ns)) return false;
           work.dla = dla;
           work.correlation = row.number_or(2, 0);
           const auto pid = row.number(3), tid = row.number(5);
           work.process = pid ? process_of(*pid) : tid ? process_of(*tid) : -1;
           work.device = row.number_or(4, 0);
           work.thread = tid.value_or(0);
           out_.work.push_back(work);
           return true;
         });
  }

  SqliteFile& file_;
  NsightTrace out_;
  std::set<std::string> tables_;
  std::vector<std::string> dla_tables_;
  std::map<std::tuple<std::int64_t, std::int64_t, std::string>, std::size_t> names_;
  std::vector<Name> name_list_;
  std::vector<std::size_t> name_of_range_;  ///< [range] index into name_list_
  std::map<std::pair<std::int64_t, std::int64_t>, Name> domains_;  ///< by process and number
  std::map<std::int64_t, std::string> strings_;
  std::set<std::int64_t> waiting_;  ///< StringIds of calls that wait for the GPU
};

}  // namespace

Result<NsightTrace> read_nsight(const std::string& path) {
  XAUTO_ASSIGN(const std::unique_ptr<SqliteFile> file, SqliteFile::open(path, kMaxValueBytes));
  XAUTO_ASSIGN(NsightTrace trace, Export(*file).read());
  if (trace.ranges.empty())
    return fail(ErrorCode::kInvalid,
                "has no NVTX range that begins and ends" +
                    (trace.notes.empty() ? "" : " (" + trace.notes.front() + ")"),
                path, "mark what shall be an XNode with nvtxRangePush and nvtxRangePop");
  return trace;
}

}  // namespace xauto::import
