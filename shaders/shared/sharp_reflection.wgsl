// Reflection of a dominant light by a surface. The importer binds `constants`, as `brdf` reads them.
#import reflector
#import sharp_light
#import sheen

fn sent_of(r: Reflector, light: SharpLight, sheen: f32) -> Reflected {
    let reflected = reflect_light(r, light.direction.xyz, light.direction.w);
    let gain = sheen_of(sheen, min(abs(dot(r.normal, r.view)), 1.0)).gain;
    return Reflected(light.irradiance.xyz * reflected.diffuse * gain, light.irradiance.xyz * reflected.specular);
}
