// Lights objects by a light that `xihe export --to unity` has written. Put it on the object, with the JSON as its asset.
// Not compiled by the project's own tests: they have no Unity. See docs/platforms.md.
using System;
using UnityEngine;
using UnityEngine.Rendering;

public class XiheLight : MonoBehaviour
{
    public TextAsset exported;
    public Light mainLight;
    public string objectName;
    public int frame;

    [Serializable]
    class MainLight
    {
        public float[] direction, color;
        public float intensity;
    }

    [Serializable]
    class Entry
    {
        public string @object;
        public int frame;
        public float[] sh;
        public MainLight mainLight;
    }

    [Serializable]
    class Export
    {
        public Entry[] lights;
    }

    void Start()
    {
        Apply();
    }

    public void Apply()
    {
        // The light in use is the last one at or before the frame; without a name, of the object that comes first.
        Entry found = null;
        var lights = JsonUtility.FromJson<Export>(exported.text).lights;
        var wanted = string.IsNullOrEmpty(objectName) ? lights[0].@object : objectName;
        foreach (var entry in lights)
            if (entry.@object == wanted && (found == null || entry.frame <= frame)) found = entry;
        if (found == null)
        {
            var first = lights[0].@object;
            Debug.LogWarning($"XiheLight: the file has no light of '{wanted}'; Object Name could be '{first}'", this);
            return;
        }
        var probe = new SphericalHarmonicsL2();
        for (var channel = 0; channel < 3; channel++)
            for (var i = 0; i < 9; i++)
                probe[channel, i] = found.sh[9 * channel + i];
        var properties = new MaterialPropertyBlock();
        properties.CopySHCoefficientArraysFrom(new[] { probe });
        foreach (var one in GetComponentsInChildren<Renderer>())
        {
            one.lightProbeUsage = LightProbeUsage.CustomProvided;
            one.SetPropertyBlock(properties);
        }
        if (mainLight == null) return;
        var main = found.mainLight;
        mainLight.enabled = main != null && main.direction != null && main.direction.Length == 3;
        if (!mainLight.enabled) return;
        mainLight.type = LightType.Directional;
        mainLight.useColorTemperature = false;
        // Colours in the file are linear; Light.color is encoded as sRGB. The built-in pipeline encodes the intensity
        // too, unless the project says otherwise: it decodes the product of both.
        var linear = new Color(main.color[0], main.color[1], main.color[2]);
        var isLinear = GraphicsSettings.lightsUseLinearIntensity;
        var encoded = isLinear ? linear.gamma : (linear * main.intensity).gamma;
        var brightest = isLinear ? 1f : Mathf.Max(encoded.maxColorComponent, 1e-6f);
        mainLight.color = encoded / brightest;
        mainLight.intensity = isLinear ? main.intensity : brightest;
        mainLight.transform.rotation =
            Quaternion.LookRotation(new Vector3(main.direction[0], main.direction[1], main.direction[2]));
    }
}
