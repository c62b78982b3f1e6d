// SPDX-License-Identifier: Apache-2.0
// xauto completion: shell completion made from the verbs themselves, so that it is never out of
// date.
#include <iostream>
#include <map>
#include <memory>

#include "xauto/command.h"

namespace xauto::cli {
namespace {

std::string joined(const std::vector<std::string>& words) {
  std::string out;
  for (const std::string& word : words) out += (out.empty() ? "" : " ") + word;
  return out;
}

/// Words that an option also takes, or that begin what it takes.
const std::map<std::string, std::vector<std::string>> kMoreValues = {
    {"--platform", {"small", "large", "core-ultra"}},
    {"--overload", {"newest", "skip", "queue:"}},
    {"--activation", {"worst", "median"}}};

std::string bash(const std::vector<Verb>& verbs) {
  std::vector<std::string> names;
  std::string words, values;
  for (const auto& verb : verbs) {
    names.push_back(verb.name());
    std::vector<std::string> options;
    for (const auto& option : verb.options()) {
      if (!option.name.empty()) options.push_back(option.name);
      std::vector<std::string> takes = option.values;
      if (const auto more = kMoreValues.find(option.name); more != kMoreValues.end())
        takes.insert(takes.end(), more->second.begin(), more->second.end());
      if (!takes.empty())
        values +=
            "    '" + verb.name() + " " + option.name + "') values=\"" + joined(takes) + "\" ;;\n";
    }
    words += "    " + verb.name() + ") words=\"" + joined(options) + "\" ;;\n";
  }
  return "# bash completion for xauto: source <(xauto completion bash)\n"
         "_xauto() {\n"
         "  local current=\"${COMP_WORDS[COMP_CWORD]}\" before=\"${COMP_WORDS[COMP_CWORD-1]}\"\n"
         "  local verb=\"${COMP_WORDS[1]}\" words=\"\" values=\"\" i\n"
         "  if [ \"$COMP_CWORD\" -eq 1 ]; then\n"
         "    COMPREPLY=($(compgen -W \"" +
         joined(names) +
         "\" -- \"$current\"))\n"
         "    return\n"
         "  fi\n"
         "  for ((i = 2; i < COMP_CWORD; i++)); do  # behind -- it is the app's command line\n"
         "    if [ \"${COMP_WORDS[i]}\" = \"--\" ]; then\n"
         "      COMPREPLY=($(compgen -f -- \"$current\"))\n"
         "      return\n"
         "    fi\n"
         "  done\n"
         "  case \"$verb\" in\n" +
         words +
         "  esac\n"
         "  case \"$before\" in -*) ;; *) before=\"\" ;; esac\n"
         "  case \"$verb $before\" in\n" +
         values +
         "  esac\n"
         "  case \"$current\" in\n"
         "    -*) COMPREPLY=($(compgen -W \"$words\" -- \"$current\")) ;;\n"
         "    *) COMPREPLY=($(compgen -W \"$values\" -- \"$current\") $(compgen -f -- "
         "\"$current\")) "
         ";;\n"
         "  esac\n"
         "}\n"
         "complete -o filenames -F _xauto xauto\n";
}

std::string zsh(const std::vector<Verb>& verbs) {
  // zsh runs bash completions; one source of truth is worth more than prettier descriptions.
  return "# zsh completion for xauto: source <(xauto completion zsh)\n"
         "autoload -U +X bashcompinit && bashcompinit\n" +
         bash(verbs);
}

}  // namespace

void add_completion(Commands& commands) {
  auto shell = std::make_shared<std::string>("bash");
  Verb verb = commands.add(
      "completion", "Print shell completion for bash or zsh.", "source <(xauto completion bash)",
      [&commands, shell](const Options&) {
        std::cout << (*shell == "zsh" ? zsh(commands.verbs()) : bash(commands.verbs()));
        return kDone;
      });
  verb.option("shell", *shell, "bash or zsh").one_of({"bash", "zsh"}).shown();
}

}  // namespace xauto::cli
