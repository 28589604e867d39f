/** Starts the page: a take in the file, a service's studio, or a viewer of GLB files. */

import "./style.css";

import { base64Bytes, type Packed, unpack } from "./data/packed";
import { Take } from "./data/take";
import { $, messageOf, notice } from "./dom";
import { Player } from "./player";
import { Site } from "./site/site";
import { Studio } from "./studio/studio";

const text = (id: string) => $(id)?.textContent ?? "";

/** The takes that `deitalk.preview.page` put into the file. */
async function loadTakes(player: Player, head: Packed): Promise<void> {
  const packed = [await unpack(text("take-0"))];
  while (text(`take-${packed.length}`)) packed.push(await unpack(text(`take-${packed.length}`)));
  const [take, ...others] = packed.map((each) => new Take(each, head.facts as Take["board"]));
  player.load(take, text("audio-0") ? base64Bytes(text("audio-0")) : null, others);
}

async function start(): Promise<void> {
  const head = text("head") ? await unpack(text("head")) : undefined;
  const player = new Player(head);
  $("notice").addEventListener("click", () => String(getSelection()) || notice(""));
  let studio: Studio | undefined, site: Site | undefined;
  if (head && text("take-0")) await loadTakes(player, head);
  else if (head && text("service")) await (studio = new Studio(player)).restore();
  else if (head && text("site")) site = new Site(player, JSON.parse(text("site")));
  else notice("No take in this page: drop a GLB here, or make one with: deitalk preview take/ -o preview.html");
  player.layout();
  Object.assign(window, { deitalk: { page: player, studio, site, ready: true } });
}

start().catch((error) => {
  notice(`The page could not start: ${messageOf(error)}`);
  console.error(error);
});
