// SPDX-License-Identifier: Apache-2.0
#include "import/amalthea.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <utility>

#include "model/json.h"

#include "import/questions.h"
#include "import/xml.h"

namespace xauto::import {
namespace {

constexpr double kMostPs = 1e18;  ///< eleven days
constexpr int kMaxDeviationDepth = 6, kMaxItemDepth = 32;
constexpr std::size_t kMaxChainEvents = 1000;

// ---- references and values ------------------------------------------------------------------------

int hex_of(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  const char lower = static_cast<char>(c | 0x20);
  return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
}

/// "amlt:/#Generic+Core?type=CoreType" is 'Generic Core': names are written as in URLs.
std::string name_in(std::string_view reference) {
  if (const std::size_t hash = reference.find('#'); hash != std::string_view::npos)
    reference.remove_prefix(hash + 1);
  reference = reference.substr(0, reference.find("?type="));
  std::string name;
  for (std::size_t i = 0; i < reference.size(); ++i) {
    const int high = i + 2 < reference.size() ? hex_of(reference[i + 1]) : -1;
    const int low = i + 2 < reference.size() ? hex_of(reference[i + 2]) : -1;
    if (reference[i] == '%' && high >= 0 && low >= 0) {
      name += static_cast<char>(high * 16 + low);
      i += 2;
    } else {
      name += reference[i] == '+' ? ' ' : reference[i];
    }
  }
  return name;
}

/// What an element refers to by an attribute, or where that is in another file by a child with href.
std::vector<std::string> references(const Xml& element, std::string_view key) {
  std::vector<std::string> names;
  std::string_view rest = element[key];
  while (!rest.empty()) {
    const std::size_t space = std::min(rest.find(' '), rest.size());
    if (space > 0) names.push_back(name_in(rest.substr(0, space)));
    rest.remove_prefix(std::min(space + 1, rest.size()));
  }
  for (const Xml& child : element.children)
    if (child.name == key && !child["href"].empty()) names.push_back(name_in(child["href"]));
  return names;
}

std::string reference(const Xml& element, std::string_view key) {
  const std::vector<std::string> names = references(element, key);
  return names.empty() ? "" : names.front();
}

/// "am:Ticks" is Ticks.
std::string_view type_of(const Xml& element) {
  const std::string& type = element["xsi:type"];
  const std::size_t colon = type.find(':');
  return colon == std::string::npos ? std::string_view(type)
                                    : std::string_view(type).substr(colon + 1);
}

/// None: it is no number that is finite. (Not by from_chars, which libstdc++ 10 has for whole numbers only.)
std::optional<double> number_in(const std::string& text) {
  if (text.empty() || text.find_first_not_of("0123456789+-.eE") != std::string::npos)
    return std::nullopt;
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (end != text.c_str() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

/// In ps where a unit says so, else the number.
std::optional<double> value_of(const Xml& element) {
  auto value = element["value"].empty() ? std::optional<double>(0) : number_in(element["value"]);
  static constexpr std::pair<std::string_view, double> kUnits[] = {
      {"s", 1e12}, {"ms", 1e9}, {"us", 1e6}, {"ns", 1e3}, {"ps", 1}};
  if (value)
    for (const auto& [unit, ps] : kUnits)
      if (element["unit"] == unit) *value *= ps;
  return value;
}

std::optional<std::int64_t> time_of(const Xml* element) {
  if (element == nullptr || element->operator[]("unit").empty()) return std::nullopt;
  const auto ps = value_of(*element);
  if (!ps || !(*ps >= 0) || *ps > kMostPs) return std::nullopt;
  return std::llround(*ps);
}

std::int64_t time_or_0(const Xml* element) {
  return time_of(element).value_or(0);
}

double frequency_of(const Xml& element) {
  static constexpr std::pair<std::string_view, double> kUnits[] = {
      {"Hz", 1e-6}, {"kHz", 1e-3}, {"MHz", 1}, {"GHz", 1e3}};
  const auto value = number_in(element["value"]);
  for (const auto& [unit, per_us] : kUnits)
    if (value && *value > 0 &&
        (element["unit"] == unit || (element["unit"].empty() && unit == "Hz")))
      return *value * per_us;
  return 0;
}

/// What a deviation of any version says, wherever in it: bounds, a mean, constants, a histogram.
struct Gathered {
  std::optional<double> lowest, highest, mean, sd;
  double weighted = 0, weights = 0;

  static void take(std::optional<double>& into, std::optional<double> value, bool larger) {
    if (value && (!into || (larger ? *value > *into : *value < *into))) into = value;
  }
  void gather(const Xml& element, int depth) {
    if (depth > kMaxDeviationDepth) return;
    const auto attribute = [&](const char* key) {
      return element[key].empty() ? std::nullopt : number_in(element[key]);
    };
    const auto low = attribute("lowerBound"), high = attribute("upperBound");
    take(lowest, low, false);
    take(highest, high, true);
    for (const char* key : {"average", "mean"}) take(mean, attribute(key), true);
    take(sd, attribute("sd"), true);
    if (low && high && element.name == "entries") {
      const double times = attribute("occurrences").value_or(1);
      weights += times;
      weighted += times * (*low + *high) / 2;
    }
    const bool has_value = !element["value"].empty() && element.children.empty();
    if (element.name == "lowerBound")
      take(lowest, value_of(element), false);
    else if (element.name == "upperBound")
      take(highest, value_of(element), true);
    else if (element.name == "average" || element.name == "mean")
      take(mean, value_of(element), true);
    else if (element.name == "sd")
      take(sd, value_of(element), true);
    else if (has_value) {
      take(lowest, value_of(element), false);
      take(highest, value_of(element), true);
    }
    for (const Xml& child : element.children) gather(child, depth + 1);
  }
};

std::optional<Deviation> deviation_of(const Xml& element) {
  Gathered all;
  all.gather(element, 0);
  Deviation made;
  if (all.highest) {
    made.highest = *all.highest;
  } else if (all.mean) {
    made.highest = *all.mean + 3 * all.sd.value_or(0);
    made.bounded = false;
  } else {
    return std::nullopt;
  }
  if (!(made.highest >= 0)) return std::nullopt;
  made.lowest = std::clamp(all.lowest.value_or(0), 0.0, made.highest);
  const double middle =
      all.weights > 0 ? all.weighted / all.weights : (made.lowest + made.highest) / 2;
  made.usual = std::clamp(all.mean.value_or(middle), made.lowest, made.highest);
  return made;
}

// ---- the model --------------------------------------------------------------------------------------

class AmaltheaReader {
 public:
  AmaltheaModel read(const std::vector<Xml>& roots) {
    for (const Xml& root : roots) {
      // "am:Amalthea" holds the models; a file of 0.7 may be one of them.
      static const std::map<std::string_view, std::string_view> kModels = {
          {"SWModel", "swModel"},
          {"HWModel", "hwModel"},
          {"StimuliModel", "stimuliModel"},
          {"EventModel", "eventModel"},
          {"ConstraintsModel", "constraintsModel"},
          {"MappingModel", "mappingModel"}};
      const std::size_t colon = root.name.find(':');
      const auto alone = kModels.find(std::string_view(root.name).substr(colon + 1));
      if (colon != std::string::npos && alone != kModels.end())
        read_part(root, alone->second);
      else
        for (const Xml& part : root.children) read_part(part, part.name);
    }
    finish_units();
    return std::move(out_);
  }

 private:
  void note(std::string line) {
    if (out_.notes.size() < kMaxAmaltheaNotes) out_.notes.push_back(std::move(line));
  }

  void read_part(const Xml& part, std::string_view name) {
    if (name == "swModel") read_software(part);
    if (name == "stimuliModel")
      for (const Xml& stimulus : part.children)
        if (stimulus.name == "stimuli") read_stimulus(stimulus);
    if (name == "hwModel") read_hardware(part, 0);
    if (name == "eventModel")
      for (const Xml& e : part.children)
        out_.events[e["name"]] = {e["name"], std::string(type_of(e)), reference(e, "entity"),
                                  reference(e, "runnable"), reference(e, "process")};
    if (name == "constraintsModel") read_constraints(part);
    if (name == "mappingModel")
      for (const Xml& allocation : part.children)
        if (allocation.name == "taskAllocation" && !allocation["affinity"].empty())
          on_[reference(allocation, "task")] = references(allocation, "affinity");
  }

  // ---- software ---------------------------------------------------------------------------------------

  void read_software(const Xml& software) {
    for (const Xml& element : software.children) {
      if (element.name == "tasks" || element.name == "isrs") {
        AmaltheaTask task{element["name"], references(element, "stimuli"), {}, {}};
        read_items(element, task.items, 0);
        out_.tasks.push_back(std::move(task));
      } else if (element.name == "runnables") {
        std::vector<ActivityItem>& items = out_.runnables[element["name"]];
        items.clear();
        read_items(element, items, 0);
      }
    }
  }

  static bool holds_items(std::string_view name) {
    return name == "activityGraph" || name == "callGraph" || name == "items" || name == "calls" ||
           name == "graphEntries" || name == "runnableItems";
  }

  /// In their order, through groups and sequences.
  void read_items(const Xml& holder, std::vector<ActivityItem>& into, int depth) {
    if (depth > kMaxItemDepth)
      return note("an activity graph is nested too deep: the rest is left out");
    for (const Xml& child : holder.children) {
      if (!holds_items(child.name)) continue;
      const std::string_view type = type_of(child);
      ActivityItem item;
      using Kind = ActivityItem::Kind;
      if (type.ends_with("Switch")) {
        item.kind = Kind::kSwitch;
        for (const Xml& branch : child.children)
          if (branch.name == "entries" || branch.name == "defaultEntry")
            read_items(branch, item.branches.emplace_back(), depth + 1);
      } else if (type == "RunnableCall" || type == "TaskRunnableCall") {
        item.kind = Kind::kRunnable;
        item.name = reference(child, "runnable");
      } else if (type == "LabelAccess") {
        item.kind = Kind::kAccess;
        item.name = reference(child, "data");
        item.write = child["access"] == "write";
      } else if (type == "ChannelSend" || type == "ChannelReceive") {
        item.kind = Kind::kAccess;
        item.name = "channel " + reference(child, "data");
        item.write = type == "ChannelSend";
      } else if (type == "InterProcessTrigger" || type == "InterProcessActivation") {
        item.kind = Kind::kTrigger;
        item.name = reference(child, "stimulus");
      } else if (type == "WaitEvent" || type == "SetEvent") {
        item.kind = type == "WaitEvent" ? Kind::kWait : Kind::kSet;
        if (const Xml* mask = child.child("eventMask")) item.events = references(*mask, "events");
      } else if (type == "Ticks" || type == "RunnableInstructions" || type == "ExecutionNeed") {
        read_ticks(child, item);
      } else {
        if (type.ends_with("Loop")) note("a loop is read as one turn: " + std::string(type));
        read_items(child, into, depth + 1);  // a group, a sequence, or what holds none
        continue;
      }
      if (child.child("counter") != nullptr)
        note("counters are left out: a trigger comes each time");
      into.push_back(std::move(item));
    }
  }

  void read_ticks(const Xml& element, ActivityItem& item) {
    for (const Xml& need : element.children) {
      const auto deviation = deviation_of(need);
      // 0.8: default is keyed by what is counted, "Instructions"; extended by the type of the core.
      std::string where = reference(need, "key");
      if (where.empty() && need.name == "extended") where = reference(need, "coreType");
      if (!deviation)
        note("execution needs that state neither a bound nor a mean are left out");
      else if (need.name == "extended" && !where.empty())
        item.ticks_on[where] = *deviation;
      else if (need.name == "default" || need.name == "needs")
        item.ticks = *deviation;
    }
  }

  // ---- stimuli ----------------------------------------------------------------------------------------

  void read_stimulus(const Xml& element) {
    using Kind = AmaltheaStimulus::Kind;
    AmaltheaStimulus made;
    made.name = element["name"];
    made.type = type_of(element);
    made.offset_ps = time_or_0(element.child("offset"));
    const auto between = [&](const char* child) {
      const Xml* found = element.child(child);
      const auto deviation = found == nullptr ? std::nullopt : deviation_of(*found);
      if (!deviation || deviation->highest > kMostPs) return;
      made.kind = Kind::kSporadic;
      made.least_ps = std::llround(deviation->lowest);
      made.most_ps = std::llround(deviation->highest);
    };
    const std::string_view type = made.type;
    if (type == "InterProcessStimulus" || type == "InterProcess") {
      made.kind = Kind::kInterProcess;
    } else if (type == "EventStimulus") {
      made.kind = Kind::kEvent;
      made.events = references(element, "triggeringEvents");
    } else if (type == "PeriodicStimulus" || type == "Periodic" || type == "PeriodicEvent") {
      made.least_ps = made.most_ps = time_or_0(element.child("recurrence"));
      if (made.least_ps > 0) made.kind = Kind::kPeriodic;
      for (const char* jitter : {"jitter", "stimulusDeviation"})
        if (const Xml* found = element.child(jitter))
          if (const auto deviation = deviation_of(*found);
              deviation && deviation->highest <= kMostPs)
            made.jitter_ps = std::llround(deviation->highest);
    } else if (type == "RelativePeriodicStimulus") {
      between("nextOccurrence");
    } else if (type == "SporadicStimulus" || type == "Sporadic") {
      between("stimulusDeviation");
      if (made.kind == Kind::kOther) between("occurrence");
    } else if (type == "ArrivalCurveStimulus" || type == "ArrivalCurve") {
      read_curve(element, made);
    }
    if (made.least_ps <= 0 && made.kind == Kind::kSporadic) made.kind = Kind::kOther;
    out_.stimuli[made.name] = std::move(made);
  }

  /// Two of them are so far apart at least.
  static void read_curve(const Xml& element, AmaltheaStimulus& made) {
    for (const Xml& entry : element.children)
      if (entry.name == "entries" && entry["numberOfOccurrences"] == "2") {
        made.kind = AmaltheaStimulus::Kind::kSporadic;
        made.least_ps = time_or_0(entry.child("lowerTimeBorder"));
        made.most_ps = std::max(made.least_ps, time_or_0(entry.child("upperTimeBorder")));
      }
  }

  // ---- hardware ---------------------------------------------------------------------------------------

  struct Definition {
    std::string type = "cpu";
    double per_cycle = 1;  ///< instructions; ticks are cycles
  };

  void read_hardware(const Xml& part, int depth) {
    if (depth > kMaxItemDepth) return;
    for (const Xml& element : part.children) {
      const std::string_view type = type_of(element);
      if (element.name == "definitions" && type == "ProcessingUnitDefinition") {
        Definition& made = definitions_[element["name"]];
        const std::string& unit = element["puType"];
        made.type = unit == "GPU" ? "gpu" : unit == "Accelerator" ? "accelerator" : "cpu";
        if (made.type == "accelerator" && upper(element["name"]).find("DLA") != std::string::npos)
          made.type = "dla";
      } else if (element.name == "coreTypes") {
        const auto per_cycle = number_in(element["instructionsPerCycle"]);
        definitions_[element["name"]].per_cycle = per_cycle && *per_cycle > 0 ? *per_cycle : 1;
      } else if (element.name == "domains" || element.name == "quartzes") {
        for (const Xml& value : element.children)
          if (value.name == "defaultValue" || value.name == "frequency")
            frequencies_[element["name"]] = frequency_of(value);
        if (const auto hz = number_in(element["frequency"]); hz && *hz > 0)
          frequencies_[element["name"]] = *hz * 1e-6;
      } else if (element.name == "modules" && type == "ProcessingUnit") {
        units_.push_back({element["name"], reference(element, "definition"),
                          reference(element, "frequencyDomain")});
      } else if (element.name == "cores") {
        std::string clock;
        for (const Xml& below : element.children)
          if (below.name == "prescaler") clock = reference(below, "quartz");
        units_.push_back({element["name"], reference(element, "coreType"), clock});
      }
      read_hardware(element, depth + 1);
    }
  }

  static std::string upper(std::string text) {
    for (char& c : text) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
    return text;
  }

  void finish_units() {
    for (const auto& [name, definition, clock] : units_) {
      const auto found = definitions_.find(definition);
      const Definition made = found == definitions_.end() ? Definition{} : found->second;
      const auto frequency = frequencies_.find(clock);
      out_.units.push_back(
          {name, definition, made.type,
           frequency == frequencies_.end() ? 0 : frequency->second * made.per_cycle});
    }
    for (AmaltheaTask& task : out_.tasks)
      if (const auto on = on_.find(task.name); on != on_.end()) task.on = on->second;
  }

  // ---- constraints ------------------------------------------------------------------------------------

  /// The events of its segments, else its own two.
  void read_chain(const Xml& chain, std::vector<std::string>& into, int depth) {
    if (depth > kMaxItemDepth || into.size() > kMaxChainEvents) return;
    const auto take = [&](std::string event) {
      if (!event.empty() && (into.empty() || into.back() != event))
        into.push_back(std::move(event));
    };
    bool any = false;
    for (const Xml& segment : chain.children) {
      if (segment.name == "strands") note("of '" + chain["name"] + "' the strands are left out");
      const Xml* below = segment.name == "segments" || segment.name == "items"
                             ? segment.child("eventChain")
                             : nullptr;
      if (below == nullptr) continue;
      any = true;
      read_chain(*below, into, depth + 1);
    }
    if (any) return;
    take(reference(chain, "stimulus"));
    take(reference(chain, "response"));
  }

  void read_constraints(const Xml& part) {
    for (const Xml& element : part.children) {
      if (element.name == "eventChains") {
        AmaltheaChain chain{element["name"], {}};
        read_chain(element, chain.events, 0);
        out_.chains.push_back(std::move(chain));
      } else if (element.name == "requirements") {
        const Xml* limit = element.child("limit");
        if (limit == nullptr || type_of(*limit) != "TimeRequirementLimit" ||
            (*limit)["limitType"] != "UpperLimit" || (*limit)["metric"] != "ResponseTime") {
          ++unknown_requirements_;
          continue;
        }
        if (const auto ps = time_of(limit->child("limitValue")))
          out_.limits.push_back(
              {reference(element, "process"), reference(element, "runnable"), "", *ps});
      } else if (element.name == "timingConstraints") {
        const auto ps = time_of(element.child("maximum"));
        if (type_of(element) == "EventChainLatencyConstraint" && ps)
          out_.limits.push_back({"", "", reference(element, "scope"), *ps});
        else
          ++unknown_requirements_;
      }
    }
    if (unknown_requirements_ > 0)
      note("left out: " + counted(unknown_requirements_, "requirement") +
           " that limit no response time from above");
  }

  struct Unit {
    std::string name, definition, clock;
  };

  AmaltheaModel out_;
  std::vector<Unit> units_;
  std::map<std::string, Definition> definitions_;
  std::map<std::string, double> frequencies_;  ///< per us
  std::map<std::string, std::vector<std::string>> on_;
  std::size_t unknown_requirements_ = 0;
};

bool has_suffix(const std::filesystem::path& path) {
  return path.extension() == ".amxmi";
}

}  // namespace

Result<AmaltheaModel> parse_amalthea(
    const std::vector<std::pair<std::string, std::string>>& names_and_texts) {
  std::vector<Xml> roots;
  for (const auto& [name, text] : names_and_texts) {
    XAUTO_ASSIGN(Xml root, parse_xml(text, name));
    roots.push_back(std::move(root));
  }
  AmaltheaModel model = AmaltheaReader().read(roots);
  if (model.tasks.empty())
    return fail(ErrorCode::kInvalid, "has no task",
                names_and_texts.empty() ? "" : names_and_texts.front().first,
                "name an .amxmi file with a software model, or the folder of such files");
  return model;
}

bool is_amalthea(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_directory(path, error)) return has_suffix(path);
  for (const auto& entry : std::filesystem::directory_iterator(path, error))
    if (has_suffix(entry.path())) return true;
  return false;
}

Result<AmaltheaModel> read_amalthea(const std::string& path) {
  std::vector<std::string> files;
  std::error_code error;
  if (!std::filesystem::is_directory(path, error)) {
    files.push_back(path);
  } else {
    for (const auto& entry : std::filesystem::directory_iterator(path, error))
      if (has_suffix(entry.path()) && files.size() <= kMaxAmaltheaFiles)
        files.push_back(entry.path().string());
    if (files.size() > kMaxAmaltheaFiles)
      return fail(ErrorCode::kInvalid, "has more than 64 .amxmi files", path, "name one");
    std::ranges::sort(files);
  }
  std::vector<std::pair<std::string, std::string>> texts;
  for (const std::string& file : files) {
    XAUTO_ASSIGN(std::string text, read_file(file));
    texts.emplace_back(file, std::move(text));
  }
  return parse_amalthea(texts);
}

}  // namespace xauto::import
