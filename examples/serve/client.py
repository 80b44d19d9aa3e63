"""Ask a running ``preshape serve`` for a plan: python client.py [ADDRESS [REQUEST [TOKEN]]]."""

import json
import sys
import urllib.error
import urllib.request

usual = ["http://localhost:8090", '{"object": "mug", "task": "pour", "hand": "shadow"}', ""]
address, asked, token = [*sys.argv[1:], *usual[len(sys.argv) - 1 :]]
request = urllib.request.Request(
    f"{address}/plan",
    data=asked.encode(),
    headers={"Content-Type": "application/json", "Authorization": f"Bearer {token}"},
)
try:
    plan = json.load(urllib.request.urlopen(request))
except urllib.error.HTTPError as error:
    sys.exit(json.load(error)["reason"])
print(plan["object"]["name"], plan["status"], plan["reason"])
if plan["status"] == "answer":
    print("palm at", plan["hand"]["grasp"]["palm_pose"], "joints", plan["hand"]["grasp"]["q"])
