// SPDX-License-Identifier: Apache-2.0
// xauto completion: shell completion made from the verbs themselves, so that it is never out of
// date.
#include <iostream>
#include <memory>

#include "xauto/command.h"

namespace xauto::cli {
namespace {

std::string joined(const std::vector<std::string>& words) {
  std::string out;
  for (const std::string& word : words) out += (out.empty() ? "" : " ") + word;
  return out;
}

std::string bash(const std::vector<Commands::Verb>& verbs) {
  std::vector<std::string> names;
  std::string cases;
  for (const auto& verb : verbs) {
    names.push_back(verb.name);
    cases += "    " + verb.name + ") words=\"" + joined(verb.options) + "\" ;;\n";
  }
  return "# bash completion for xauto: source <(xauto completion bash)\n"
         "_xauto() {\n"
         "  local current=\"${COMP_WORDS[COMP_CWORD]}\" words=\"\"\n"
         "  if [ \"$COMP_CWORD\" -eq 1 ]; then\n"
         "    COMPREPLY=($(compgen -W \"" +
         joined(names) +
         "\" -- \"$current\"))\n"
         "    return\n"
         "  fi\n"
         "  case \"${COMP_WORDS[1]}\" in\n" +
         cases +
         "  esac\n"
         "  case \"$current\" in\n"
         "    -*) COMPREPLY=($(compgen -W \"$words\" -- \"$current\")) ;;\n"
         "    *) COMPREPLY=($(compgen -f -- \"$current\")) ;;\n"
         "  esac\n"
         "}\n"
         "complete -o filenames -F _xauto xauto\n";
}

std::string zsh(const std::vector<Commands::Verb>& verbs) {
  // zsh runs bash completions; one source of truth is worth more than prettier descriptions.
  return "# zsh completion for xauto: source <(xauto completion zsh)\n"
         "autoload -U +X bashcompinit && bashcompinit\n" +
         bash(verbs);
}

}  // namespace

void add_completion(Commands& commands) {
  auto shell = std::make_shared<std::string>("bash");
  CLI::App* verb = commands.add(
      "completion", "Print shell completion for bash or zsh.", "source <(xauto completion bash)",
      [&commands, shell](const Options&) {
        std::cout << (*shell == "zsh" ? zsh(commands.verbs()) : bash(commands.verbs()));
        return kDone;
      });
  verb->add_option("shell", *shell, "bash or zsh")
      ->check(CLI::IsMember({"bash", "zsh"}))
      ->capture_default_str();
}

}  // namespace xauto::cli
