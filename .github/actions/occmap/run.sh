#!/usr/bin/env bash
# What the action does once occmap is installed; its inputs are environment variables.
set -euo pipefail

: "${LOG:?}" "${FOLDER:=occmap-map}" "${FAIL_ABOVE:=2%}"
mkdir -p "$FOLDER"

# The limits, one a line, as words of the command line.
list_limits() {
  while IFS= read -r limit; do
    if [ -n "${limit// /}" ]; then
      printf '%s\n' --fail-if "$limit"
    fi
  done <<< "$1"
}
mapfile -t check_limits < <(list_limits "${CHECK_FAIL_IF:-}")
mapfile -t build_limits < <(list_limits "${FAIL_IF:-}")
# Other options are split as by a shell: quotes keep blanks within a word.
split() {
  xargs -r -n 1 printf '%s\n' <<< "$1"
}
log_words=$(split "${LOG_OPTIONS:-}")
words=$(split "${OPTIONS:-}")
log_options=() options=()
[ -z "$log_words" ] || mapfile -t log_options <<< "$log_words"
[ -z "$words" ] || mapfile -t options <<< "$words"

occmap check "$LOG" "${log_options[@]}" "${check_limits[@]}" --json > "$FOLDER/check.json"
occmap build "$LOG" "${log_options[@]}" "${options[@]}" "${build_limits[@]}" --strict --json \
  -o "$FOLDER/map.pgm" -o "$FOLDER/map.png" -o "$FOLDER/map.npz" > "$FOLDER/build.json"
if [ -n "${REFERENCE:-}" ]; then
  occmap diff "$REFERENCE" "$FOLDER/map.pgm" -o "$FOLDER/diff.png" --fail-above "$FAIL_ABOVE" \
    --json > "$FOLDER/diff.json"
fi
