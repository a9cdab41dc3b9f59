#!/usr/bin/env bash
# Builds three.min.js and LICENSE of entry.js, with the versions of package-lock.json. Needs node and npm.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$here"/{entry.js,package.json,package-lock.json} "$work"
cd "$work"
npm ci --silent --no-audit --no-fund
npx esbuild entry.js --bundle --minify --target=es2020 --format=iife --global-name=THREE \
  --legal-comments=inline --outfile="$here/three.min.js"
cp node_modules/three/LICENSE "$here/LICENSE"
