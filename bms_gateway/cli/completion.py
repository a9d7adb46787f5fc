"""`completion`: shell scripts that complete commands and options, and a manual page, made from the program itself."""

import argparse
import importlib
import sys

from bms_gateway.cli.main import COMMANDS, PROGRAM, Parser

EXAMPLE = """
  bms-gateway completion bash > ~/.local/share/bash-completion/completions/bms-gateway
  bms-gateway completion zsh > "${fpath[1]}/_bms-gateway"
  bms-gateway completion fish > ~/.config/fish/completions/bms-gateway.fish
  bms-gateway completion man > ~/.local/share/man/man1/bms-gateway.1
"""
KINDS = ("bash", "zsh", "fish", "man")


def arguments(parser: Parser) -> None:
    """Declare the argument."""
    parser.option("kind", choices=KINDS, metavar="bash|zsh|fish|man", help="the shell, or the manual page")


def run(args: argparse.Namespace) -> int:
    """Print it."""
    sys.stdout.write({"bash": _bash, "zsh": _zsh, "fish": _fish, "man": _man}[args.kind]())
    return 0


def _parsers() -> dict[str, Parser]:
    found = {}
    for name, summary in COMMANDS.items():
        module = importlib.import_module(f"bms_gateway.cli.{name}")
        found[name] = Parser(name, summary, module.EXAMPLE)
        module.arguments(found[name])
    return found


def _bash() -> str:
    cases = "\n".join(f"    {name}) words='{' '.join(p.options)}' ;;" for name, p in _parsers().items())
    return f"""# bash completion of {PROGRAM}
_bms_gateway() {{
  local words='' now=${{COMP_WORDS[COMP_CWORD]}}
  if [ "$COMP_CWORD" = 1 ]; then
    mapfile -t COMPREPLY < <(compgen -W '{" ".join(COMMANDS)} --help --version' -- "$now")
    return
  fi
  case ${{COMP_WORDS[1]}} in
{cases}
  esac
  case $now in
    -*) mapfile -t COMPREPLY < <(compgen -W "$words" -- "$now") ;;
    *) mapfile -t COMPREPLY < <(compgen -f -- "$now"); compopt -o filenames ;;
  esac
}}
complete -F _bms_gateway {PROGRAM}
"""


def _plain(text: str) -> str:
    return text.replace("'", "").replace("[", "(").replace("]", ")").replace(":", " -").replace("%%", "%")


def _zsh() -> str:
    commands = "\n".join(f"    '{name}:{_plain(summary)}'" for name, summary in COMMANDS.items())
    cases = "\n".join(
        f"    {name}) _arguments {' '.join(repr(o) for o in p.options)} '*:file:_files' ;;"
        for name, p in _parsers().items()
    )
    return f"""#compdef {PROGRAM}
_bms_gateway() {{
  local -a commands=(
{commands}
  )
  if (( CURRENT == 2 )); then
    _describe command commands
    return
  fi
  local name=$words[2]
  shift words
  (( CURRENT-- ))
  case $name in
{cases}
  esac
}}
_bms_gateway "$@"
"""


def _fish() -> str:
    lines = [f"# fish completion of {PROGRAM}"]
    for name, summary in COMMANDS.items():
        lines.append(f"complete -c {PROGRAM} -n __fish_use_subcommand -f -a {name} -d '{_plain(summary)}'")
    for name, p in _parsers().items():
        for option in p.options:
            where = f"'__fish_seen_subcommand_from {name}'"
            lines.append(f"complete -c {PROGRAM} -n {where} -l {option.removeprefix('--')}")
    return "\n".join(lines) + "\n"


def _roff(text: str) -> str:
    """Escape the characters that have a meaning in roff."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{escaped}" if escaped.startswith((".", "'")) else escaped


def _man() -> str:
    from bms_gateway import __version__

    lines = [f'.TH BMS\\-GATEWAY 1 "" "{PROGRAM} {__version__}" "User Commands"', ".SH NAME"]
    lines += [f"{_roff(PROGRAM)} \\- core temperatures of battery cells from CAN traffic", ".SH SYNOPSIS"]
    lines += [f".B {_roff(PROGRAM)}", ".I COMMAND", "[options]", ".SH COMMANDS"]
    for name, p in _parsers().items():
        lines += [f".SS {name}", _roff(COMMANDS[name][0].upper() + COMMANDS[name][1:]) + "."]
        for action in p._actions:
            flags = ", ".join(action.option_strings) or str(action.metavar or action.dest)
            value = f" {action.metavar or action.dest.upper()}" if action.option_strings and action.nargs != 0 else ""
            lines += [
                ".TP",
                f".B {_roff(flags + value)}",
                _roff(" ".join((action.help or "").replace("%%", "%").split())),
            ]
    lines += [".SH EXIT STATUS", "0 done; 1 what was checked does not hold; 2 bad usage, config or data; 130 stopped."]
    return "\n".join(lines) + "\n"
