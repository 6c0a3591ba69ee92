// Validates KEDA objects (a JSON array on standard input) against the types of the package @kubernetes-models/keda.
import { readFileSync } from "node:fs";
import * as keda from "@kubernetes-models/keda/keda.sh/v1alpha1";

function fault(object) {
  try {
    new keda[object.kind](object).validate();
  } catch (error) {
    return error.message;
  }
}

const objects = JSON.parse(readFileSync(0, "utf8"));
const wrong = objects.map(fault).filter(Boolean);
if (wrong.length) throw new Error(wrong.join("\n"));
const scaled = objects.find((object) => object.kind === "ScaledJob");
if (!fault({ ...scaled, spec: { ...scaled.spec, maxReplicaCount: "eight" } }) || !fault({ ...scaled, spec: {} })) {
  throw new Error("control failed: this check does not detect an invalid ScaledJob");
}
console.log(`${objects.length} objects match the types of KEDA`);
