# The output of help.sh in, the manual page of one program out. -v program=NAME -v version=V -v date=YYYY-MM-DD
function roff(text) {
  gsub(/\\/, "\\e", text)
  gsub(/-/, "\\-", text)
  if (text ~ /^[.']/) text = "\\&" text
  return text
}
# "TEXT:{a,b}=a", "FLOAT:FLOAT in [0 - 1]=0.5 Needs: --x", "UINT ..." as people write them.
function kind(text,   value, rest) {
  rest = ""
  if (match(text, / Needs: .*/)) { rest = ", with " substr(text, RSTART + 8); text = substr(text, 1, RSTART - 1) }
  if (match(text, / REQUIRED/)) text = substr(text, 1, RSTART - 1) substr(text, RSTART + RLENGTH)
  sub(/^TEXT:\{/, "{", text)
  sub(/^(UINT|INT|FLOAT|TEXT):(U?INT|FLOAT|TEXT)/, substr(text, 1, index(text, ":") - 1), text)
  if (match(text, /=[^={}]*$/)) { value = substr(text, RSTART + 1); text = substr(text, 1, RSTART - 1) }
  return text (value == "" ? "" : ", default " value) rest
}
function item(line,   head, words, at) {
  line = substr(line, 3)
  at = match(line, /  +/)
  head = at ? substr(line, 1, at - 1) : line
  words = at ? substr(line, at + RLENGTH) : ""
  at = index(head, " ")
  print ".TP"
  if (at) print "\\fB" names(substr(head, 1, at - 1)) "\\fR \\fI" roff(kind(substr(head, at + 1))) "\\fR"
  else print "\\fB" names(head) "\\fR"
  if (words != "") print roff(words)
}
function names(text) { text = roff(text); gsub(/,/, "\\fR, \\fB", text); return text }
function heading(text) { print (depth == 1 ? ".SH " : ".PP\n\\fB") toupper(substr(text, 1, 1)) tolower(substr(text, 2)) (depth == 1 ? "" : "\\fR") }

/^@@ / {
  mine = $2 == program
  if (!mine) next
  depth = NF - 1
  section = "description"
  described = 0
  if (depth == 2 && !commands_begun) { print ".SH COMMANDS IN DETAIL"; commands_begun = 1 }
  if (depth > 1) { print ".SS " roff(substr($0, 4)); next }
  print ".\\\" Made of the programs' --help."
  printf ".TH %s 1 \"%s\" \"Weakgrid %s\" \"Weakgrid\"\n", toupper(roff(program)), date, version
  next
}
!mine { next }
section == "description" && /^Usage: / {
  section = ""
  usage = substr($0, 8)
  if (depth == 1) print ".SH SYNOPSIS"
  else print ".PP"
  print "\\fB" roff(usage) "\\fR"
  if (depth == 1) { print ".SH DESCRIPTION"; print description }
  next
}
section == "description" {
  if (depth == 1) {
    short = $0
    sub(/[.:;].*$/, "", short)
    description = roff($0)
    print ".SH NAME"
    print roff(program) " \\- " tolower(substr(roff(short), 1, 1)) substr(roff(short), 2)
  } else print roff($0)
  next
}
/^(Options|Positionals|Subcommands):$/ {
  section = $1
  if (depth == 1) print ".SH " ($1 == "Subcommands:" ? "COMMANDS" : $1 == "Positionals:" ? "ARGUMENTS" : "OPTIONS")
  next
}
/^$/ { section = section == "" ? "" : "over"; next }
section ~ /:$/ && /^  [^ ]/ { item($0); next }
section ~ /:$/ { sub(/^ +/, ""); print roff($0); next }
# What the programs add at the end: examples as they are, sentences as sentences.
/^Example: / {
  if (depth == 1) print ".SH EXAMPLE"
  print ".PP"
  print ".nf"
  print (depth == 1 ? "" : "Example: ") roff(substr($0, 10))
  print ".fi"
  next
}
/^ / { print ".nf"; print roff(depth == 1 ? unindented($0) : $0); print ".fi"; next }
{
  if (depth == 1 && !ended) { print ".SH EXIT STATUS"; ended = 1 }
  print ".PP"
  print roff($0)
}
function unindented(text) { sub(/^         /, "", text); return text }
END {
  print ".SH SEE ALSO"
  split("weakgrid weakgrid-plant weakgrid-controller weakgrid-unit weakgrid-gateway weakgrid-recorder weakgrid-replayer weakgrid-console", all, " ")
  line = ""
  for (n = 1; n in all; ++n) if (all[n] != program) line = line (line == "" ? "" : ", ") "\\fB" roff(all[n]) "\\fR(1)"
  print line
  print ".PP"
  print "README.md and services.md in the package documentation: settings, counters, deployment."
}
