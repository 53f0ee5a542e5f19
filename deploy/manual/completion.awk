# The output of help.sh in, a bash completion for all programs out.
function put(text) { body = body text "\n" }
function end_command() {
  if (path == "") return
  put("    '" path "') commands='" commands "' flags='" flags "' valued='" valued "' ;;")
}
/^@@ / {
  end_command()
  path = substr($0, 4); commands = flags = valued = ""; section = ""
  if (path !~ / /) programs = programs " " path
  next
}
/^(Options|Positionals|Subcommands):$/ { section = $1; next }
/^$/ { section = ""; next }
section == "Subcommands:" && /^  [a-z]/ { commands = commands (commands == "" ? "" : " ") $1 }
section == "Options:" && /^  -/ {
  # "-o,--output TEXT:{a,b}=a   words": names, and a type if it takes a value.
  split($1, names, ",")
  takes = substr($0, 3 + length($1), 1) == " " && substr($0, 4 + length($1), 1) ~ /[A-Z[]/
  for (n in names) {
    if (names[n] !~ /^-/) continue
    if (takes) valued = valued (valued == "" ? "" : " ") names[n]
    else flags = flags (flags == "" ? "" : " ") names[n]
    if (match($2, /\{[^}]*\}/)) {
      choices = substr($2, RSTART + 1, RLENGTH - 2)
      gsub(",", " ", choices)
      values = values "    '" path " " names[n] "') choices='" choices "' ;;\n"
    }
  }
}
END {
  end_command()
  print "# bash completion of Weakgrid, made of the programs' --help."
  print "_weakgrid() {"
  print "  local path=${COMP_WORDS[0]##*/} commands flags valued choices word n"
  print "  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}"
  print "  _weakgrid_command"
  print "  for ((n = 1; n < COMP_CWORD; ++n)); do"
  print "    word=${COMP_WORDS[n]}"
  print "    [[ -n $word && $word != -* && \" $commands \" == *\" $word \"* ]] || continue"
  print "    path+=\" $word\""
  print "    _weakgrid_command"
  print "  done"
  print "  COMPREPLY=()"
  print "  if [[ \" $valued \" == *\" $before \"* ]]; then"
  print "    _weakgrid_choices"
  print "    # Without choices: files, by `-o default`."
  print "    [[ -z $choices ]] || COMPREPLY=($(compgen -W \"$choices\" -- \"$current\"))"
  print "  elif [[ $current == -* ]]; then"
  print "    COMPREPLY=($(compgen -W \"$flags $valued\" -- \"$current\"))"
  print "  elif [[ -n $commands ]]; then"
  print "    COMPREPLY=($(compgen -W \"$commands\" -- \"$current\"))"
  print "  fi"
  print "}"
  print "_weakgrid_command() {"
  print "  case $path in"
  printf "%s", body
  print "    *) commands='' flags='' valued='' ;;"
  print "  esac"
  print "}"
  print "_weakgrid_choices() {"
  print "  choices=''"
  print "  case \"$path $before\" in"
  printf "%s", values
  print "  esac"
  print "}"
  print "complete -o default -F _weakgrid" programs
}
